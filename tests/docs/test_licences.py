"""docs/licences.md names every package that is installed with the program, with the licence that it declares."""

import re
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/licences.md").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BASE, EXTRAS = (
    {
        name: licence
        for name, licence, _ in re.findall(r"^\| ([a-z0-9-]+) \| (.+?) \| (.*)\|$", part, re.MULTILINE)
        if name != "package"
    }
    for part in PAGE.partition("## What is installed")[2].split("The extras bring more")
)

# How packages without a licence expression write theirs: SPDX name -> what their metadata says.
OLD_WORDS = {
    "Apache-2.0": r"Apache 2\.0|Apache Software License|Apache License, Version 2\.0",
    "BSD-2-Clause": r"BSD License",
    "BSD-3-Clause": r"BSD License|3-Clause BSD",
    "GPL-3.0-only": r"GNU General Public License v3",
    "ISC": r"ISC License",
    "LGPL-3.0-or-later": r"GNU Lesser General Public License v3 or later",
    "MIT": r"MIT",
    "PSF-2.0": r"Python Software Foundation License",
    "LicenseRef-HIDAPI": r"",  # "original", in the licence's text alone
}


def required(name: str, *, with_markers: bool, seen: set[str] | None = None) -> set[str]:
    """Everything that an installed package needs, without its extras."""
    seen = set() if seen is None else seen
    try:
        lines = distribution(name).requires or []
    except PackageNotFoundError:
        return seen
    for need in map(Requirement, lines):
        inner = canonicalize_name(need.name)
        is_extra = need.marker is not None and "extra" in str(need.marker)
        is_here = need.marker is None or not with_markers or need.marker.evaluate()
        if inner not in seen and not is_extra and is_here:
            seen.add(inner)
            required(inner, with_markers=with_markers, seen=seen)
    return seen


def base(*, with_markers: bool) -> set[str]:
    direct = {canonicalize_name(Requirement(line).name) for line in PROJECT["dependencies"]}
    return direct.union(*(required(name, with_markers=with_markers) for name in direct))


def declared(name: str) -> tuple[str | None, str]:
    """The licence expression of an installed package, and all that its metadata says in older fields."""
    found = distribution(name).metadata
    words = [
        found.get("License", ""),
        *(one for one in found.get_all("Classifier", []) if "License ::" in one),
    ]
    if words == ["UNKNOWN"]:  # an old package that names its licence in the licence file alone
        words.append(distribution(name).read_text("LICENSE") or "")
    return found.get("License-Expression"), " ".join(words)


def faults(name: str, licence: str) -> Iterator[str]:
    """Where a row of the page differs from the installed package; nothing where the package is not installed."""
    try:
        expression, words = declared(name)
    except PackageNotFoundError:
        return
    parts = set(re.split(r" (?:AND|OR) ", licence))
    if expression is not None:
        if not set(re.split(r" (?:AND|OR) ", expression)) <= parts:
            yield f"{name} declares '{expression}', the page says '{licence}'"
        return
    for part in parts:
        if not re.search(OLD_WORDS[part], words):
            yield f"{name} declares '{words}', the page says '{part}'"


def test_every_package_of_a_plain_install_has_a_licence_on_the_page() -> None:
    assert base(with_markers=True) - set(BASE) == set()


def test_the_page_names_no_package_that_is_not_installed() -> None:
    """A row without its dependency is a fault; packages for other systems or Python versions may be listed."""
    assert set(BASE) - base(with_markers=False) == set()


@pytest.mark.parametrize("name", [*BASE, *EXTRAS])
def test_the_licence_is_the_one_that_the_package_declares(name: str) -> None:
    assert list(faults(name, (BASE | EXTRAS)[name])) == []


def test_a_wrong_licence_is_noticed() -> None:
    """The comparison can fail, for packages with and without a licence expression."""
    assert list(faults("pydantic", "BSD-3-Clause")) != []
    assert list(faults("pyusb", "MIT")) != []


def test_the_direct_packages_of_the_extras_are_on_the_page() -> None:
    """What tests and tools need is left out: it is never installed at a plant."""
    lines = [line for extra, some in PROJECT["optional-dependencies"].items() for line in some]
    names = {canonicalize_name(Requirement(line).name) for line in lines} - {"gelgate"}

    assert names == set(EXTRAS)


def test_the_newest_version_in_the_changes_is_the_products() -> None:
    versions = re.findall(r"^## (\S+?),? ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)

    assert versions[0] == PROJECT["version"]
