"""`gelgate station describe --format cyclonedx`: packages, libraries in wheels, bundles and trunks, with their hashes.

That the document is CycloneDX is judged by CycloneDX's own schema in tests/project/test_trust.py.
"""

import hashlib
import json
from functools import cache
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Any

import pytest
import tiny

from edge.cli.bill_of_materials import bill_of_materials, package_component
from edge.cli.describe import Format, describe
from edge.core.errors import BundleError, ConfigError
from edge.model.bundle_writer import write_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    _, files = tiny.tiny_files(tiny.tiny_bank())
    return write_bundle(tmp_path_factory.mktemp("bundle") / "bolt", files)


@cache
def installed() -> str:
    """The bill of all that is installed, which takes a second and a half to list."""
    return bill_of_materials([])


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the program were installed alone, at a fixed time."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    package = distribution("gelgate")
    monkeypatch.setattr("edge.cli.bill_of_materials.distributions", lambda: [package])


def components(bill: str) -> dict[str, dict[str, Any]]:
    return {one["name"]: one for one in json.loads(bill)["components"]}


def test_an_installed_package_is_there_with_version_licence_and_its_foreign_library() -> None:
    """libusb comes in the wheel of libusb-package: by the package's name alone nobody would look for it."""
    found, package = components(installed())["libusb-package"], distribution("libusb-package")
    (library,) = found["components"]

    assert found["purl"] == f"pkg:pypi/libusb-package@{package.version}"
    assert found["licenses"] == [{"license": {"name": "Apache Software License"}}]
    path = package.locate_file(library["name"])
    assert library["hashes"][0]["content"] == hashlib.sha256(Path(str(path)).read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("metadata", "licence_file", "name"),
    [
        ("License: MIT", "", "MIT"),
        ("License: UNKNOWN", "  Apache License\n  Version 2.0\n\n  Terms", "Apache License Version 2.0"),
        ("License: GNU LICENSE\n         Version 3\n \n         Preamble", "", "GNU LICENSE Version 3"),
        ("License: UNKNOWN", "", None),
    ],
)
def test_a_licence_is_named_also_where_its_text_alone_states_it(
    tmp_path: Path, metadata: str, licence_file: str, name: str | None
) -> None:
    """Some packages put the whole text into the field, or say UNKNOWN beside a file."""
    folder = tmp_path / "part-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: part\nVersion: 1\n{metadata}\n")
    (folder / "LICENSE").write_text(licence_file)
    (folder / "RECORD").write_text("part-1.dist-info/METADATA,,\npart-1.dist-info/LICENSE,,\n")

    found = package_component(Distribution.at(folder)).get("licenses")

    assert found == (None if name is None else [{"license": {"name": name}}])


def test_what_needs_what_is_said_of_installed_packages() -> None:
    """The program needs what a plain install brings, and each reference is to a component that is listed once."""
    document = json.loads(installed())
    needs = {one["ref"]: one["dependsOn"] for one in document["dependencies"]}
    listed = [one["bom-ref"] for one in document["components"]]

    assert (
        f"pkg:pypi/numpy@{distribution('numpy').version}"
        in needs[document["metadata"]["component"]["bom-ref"]]
    )
    assert len(listed) == len(set(listed))
    assert {one for ones in needs.values() for one in ones} <= set(listed)


@pytest.mark.usefixtures("alone")
def test_a_bundle_and_its_trunk_are_there_by_their_hashes(bundle: Path) -> None:
    """The manifest has the hashes of all other files."""
    manifest = (bundle / "manifest.json").read_bytes()
    found = components(bill_of_materials([bundle]))

    assert found["bolt/crest"]["hashes"][0]["content"] == hashlib.sha256(manifest).hexdigest()
    trunk = hashlib.sha256((bundle / "trunk.onnx").read_bytes()).hexdigest()
    assert found["tiny"]["hashes"] == [{"alg": "SHA-256", "content": trunk}]


@pytest.mark.usefixtures("alone")
def test_the_number_follows_from_what_is_listed(bundle: Path) -> None:
    """So two bills with one number list the same; with one time they are equal."""
    without, again, with_bundle = (bill_of_materials(bundles) for bundles in ([], [], [bundle]))

    assert without == again
    assert json.loads(without)["metadata"]["timestamp"] == "2001-09-09T01:46:40Z"
    assert json.loads(without)["serialNumber"] != json.loads(with_bundle)["serialNumber"]


@pytest.mark.usefixtures("alone")
def test_what_cannot_be_listed_is_said(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match="nowhere"):
        bill_of_materials([tmp_path / "nowhere"])
    with pytest.raises(ConfigError, match="run it there"):
        describe(form=Format.CYCLONEDX, host="127.0.0.1")
