"""Who may import whom: the table of docs/architecture.md, held for every import statement of our own packages."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from statements import statements

ROOT = Path(__file__).resolve().parents[2]
OURS = ("edge", "plugins", "calibration", "export")

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| `([\w.]+)` \| (.*) \|$", PAGE.partition("## Who may import whom")[2], re.MULTILINE)
# package -> what it may import of ours besides itself. The longest name that fits a file decides.
MAY_IMPORT = {"plugins": [], **{package: re.findall(r"`([\w.]+)`", allowed) for package, allowed in ROWS}}


def imports(file: Path) -> Iterator[str]:
    """Every module of ours that the file names, at its top or inside a function."""
    for node in statements(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] in OURS)
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OURS:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def is_in(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def test_the_table_has_every_package() -> None:
    assert {"edge", "edge.core", "calibration", "export"} <= MAY_IMPORT.keys()


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_what_it_may(package: str) -> None:
    allowed = (package, *MAY_IMPORT[package])
    narrower = [other for other in MAY_IMPORT if other != package and is_in(other, package)]
    files = [
        file
        for file in (ROOT / package.replace(".", "/")).rglob("*.py")
        if not any(is_in(".".join(file.relative_to(ROOT).with_suffix("").parts), other) for other in narrower)
    ]
    found = {
        f"{file.relative_to(ROOT)}: {module}"
        for file in files
        for module in imports(file)
        if not any(is_in(module, one) for one in allowed)
    }

    assert files
    assert found == set()


def test_no_package_of_ours_is_imported_by_a_string() -> None:
    """Where a module is named by a string, neither this test nor import-linter sees it; the registry alone does so."""
    by_string = {
        str(file.relative_to(ROOT))
        for package in OURS
        for file in (ROOT / package).rglob("*.py")
        if "import_module(" in (text := file.read_text(encoding="utf-8")) or "__import__(" in text
    }

    assert by_string == {"plugins/digital_io/hid_bus.py"}  # hidapi, by the name that the system's library has
