"""Wheel and sdist hold every package and every data file of the tree, the manual and the licence."""

import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
from tracked_tree import copy_tracked

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("gelgate", "edge", "plugins", "calibration", "export")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an sdist of the tree as git knows it, and the wheel made from that sdist."""
    out = tmp_path_factory.mktemp("built")
    source = copy_tracked(tmp_path_factory.mktemp("source"))
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(source)]
    subprocess.run(build, check=True, capture_output=True)
    return out


@pytest.fixture(scope="module")
def wheel_names(built: Path) -> set[str]:
    """The file names inside the wheel."""
    with zipfile.ZipFile(next(built.glob("*.whl"))) as archive:
        return set(archive.namelist())


# What `deploy` ships; a plant's own certificates and bundles are next to it and never shipped.
DEPLOYED = ("*.*", "Dockerfile", "mosquitto/*")
# What only the checks of the repository read.
CHECKS = {"deploy/checks.txt", "deploy/judges.txt", "deploy/vex.toml"}


def tracked_files(pattern: str) -> set[str]:
    return {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob(pattern)
        if "__pycache__" not in path.parts
    }


def test_every_file_of_the_packages_is_in_the_wheel(wheel_names: set[str]) -> None:
    """A module or a data file that works from the tree also works when installed; a folder without `__init__.py` would
    import from the tree and be missing."""
    suffixes = ("py", "toml", "onnx", "json", "jinja", "rules", "service", "js", "css", "html")
    files = {name for suffix in suffixes for name in tracked_files(f"*.{suffix}")} | tracked_files("py.typed")

    assert files - wheel_names == set()
    folders = {str(Path(name).parent) for name in tracked_files("*.py")}
    assert {f"{folder}/__init__.py" for folder in folders} <= wheel_names


def test_only_the_packages_can_be_imported(wheel_names: set[str]) -> None:
    """Tests stay out; besides the interface and the four packages there are the metadata and the manual."""
    tops = {name.split("/")[0] for name in wheel_names}

    assert {top for top in tops if not top.startswith("gelgate-")} == {*PACKAGES}


def test_the_wheel_carries_the_manual(wheel_names: set[str]) -> None:
    """Every page and picture is below `share/doc/gelgate` of the environment, in the folders that links name."""
    found = [
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "docs" / "images").iterdir(),
        *(ROOT / "firmware_notes").glob("*.md"),
        *(path for name in DEPLOYED for path in (ROOT / "deploy").glob(name) if path.is_file()),
    ]
    pages = {path.relative_to(ROOT).as_posix() for path in found}
    pages |= {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md"}
    shipped = {name.partition("/data/share/doc/gelgate/")[2] for name in wheel_names} - {""}

    assert shipped == pages - CHECKS


def test_the_wheel_carries_the_licence_and_says_which(built: Path) -> None:
    """Licence, notice, and metadata that name no person and no address that does not exist."""
    with zipfile.ZipFile(next(built.glob("*.whl"))) as archive:
        folder = next(name for name in archive.namelist() if name.endswith("/METADATA")).rpartition("/")[0]
        metadata = Parser().parsestr(archive.read(f"{folder}/METADATA").decode())
        texts = {name: archive.read(f"{folder}/licenses/{name}") for name in ("LICENSE", "NOTICE")}

    assert texts == {name: (ROOT / name).read_bytes() for name in texts}
    assert metadata["License-Expression"] == "Apache-2.0"
    assert metadata["Author"] == "gelgate maintainers"
    assert metadata["Keywords"]
    assert any(one.startswith("Topic ::") for one in metadata.get_all("Classifier", []))
    assert metadata.get_all("Project-URL") is None


def test_the_sdist_can_be_built_tested_and_read(built: Path) -> None:
    """Packages, tests, manual, licence and the files that make them."""
    files = {"LICENSE", "NOTICE", "CHANGELOG.md", "README.md", "Makefile", "docs/generate.py", "docs/mqtt.md"}
    files |= {"tests/conftest.py", "tests/project/test_wheel.py", "firmware_notes/gelsight_mini.md"}
    files |= tracked_files("*.py") | tracked_files("*.onnx") | tracked_files("*.service")
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        assert files - {name.partition("/")[2] for name in archive.getnames()} == set()
