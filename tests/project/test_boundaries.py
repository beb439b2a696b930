"""Who may import whom: the table of docs/architecture.md, held for every import statement of our own packages."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OURS = ("edge", "plugins", "calibration", "export")

# package -> what it may import of ours besides itself. The longest name that fits a file decides.
MAY_IMPORT = {
    "edge.core": (),
    "edge": ("edge",),
    "plugins": (),
    "plugins.conformance": ("edge.core", "edge.model.onnx_validation", "edge.model.session"),
    "plugins.detectors": ("edge.core", "edge.validation_messages", "plugins.onnx_builder"),
    "plugins.backbones": ("edge.core", "plugins.onnx_builder", "plugins.reading"),
    "plugins.reading": ("edge.core",),
    "plugins.devices": ("edge.core", "edge.recording", "edge.clock"),
    "plugins.digital_io": ("edge.core", "edge.clock"),
    "plugins.overviews": ("edge.core", "edge.extras", "plugins.devices.v4l2"),
    "plugins.sinks": ("edge.core", "edge.messaging", "edge.page", "edge.clock"),
    "calibration": ("edge", "plugins.detectors", "plugins.backbones", "plugins.onnx_builder"),
    "export": (
        "edge",
        "plugins.detectors",
        "plugins.backbones",
        "plugins.onnx_builder",
        "plugins.reading",
        "calibration.dataset",
        "calibration.fitting",
        "calibration.metrics",
        "calibration.progress",
        "calibration.quantise",
        "calibration.threads",
    ),
}


def test_the_page_has_this_table() -> None:
    """docs/architecture.md names what each package may import, no more and no less."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([\w.]+)` \| (.*) \|$", page.partition("## Who may import whom")[2], re.M))

    assert {package: set(re.findall(r"`([\w.]+)`", rows.get(package, ""))) for package in MAY_IMPORT} == {
        package: set(allowed) for package, allowed in MAY_IMPORT.items()
    }


def imports(file: Path) -> Iterator[str]:
    """Every module of ours that the file names, at its top or inside a function."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] in OURS)
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OURS:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def is_in(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_what_it_may(package: str) -> None:
    """Of our packages only itself and those in its row."""
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
