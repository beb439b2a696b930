"""The limits of the source's shape: no circle of imports, no function of more than 59 lines, no file above 400."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from statements import statements

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("gelgate", "edge", "plugins", "calibration", "export")
MAX_FUNCTION_LINES = 59
MAX_FILE_LINES = 400


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """Every Python file of the packages, by its path."""
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    return {path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def imports(file: str, trees: dict[str, ast.Module]) -> Iterator[str]:
    """Yield the files that a file imports, at its top or inside a function; a package counts as its `__init__.py`."""
    for node in statements(trees[file]):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            # The module or package `a.b.c`, else the name `c` of `a.b`.
            path, parent = name.replace(".", "/"), name.rpartition(".")[0].replace(".", "/")
            meanings = (f"{path}.py", f"{path}/__init__.py", f"{parent}.py", f"{parent}/__init__.py")
            yield from [meaning for meaning in meanings if meaning in trees and meaning != file][:1]


def room(file: str) -> str:
    """Name the folder or file directly in a package that a file is, or is in."""
    return "/".join(file.split("/")[:2])


def test_nothing_imports_itself_through_others(trees: dict[str, ast.Module]) -> None:
    """Neither modules nor rooms: a module can be read without reading those that need it, and rooms have an order."""
    modules = {file: set(imports(file, trees)) for file in trees}
    rooms: dict[str, set[str]] = {}
    for file, others in modules.items():
        rooms.setdefault(room(file), set()).update({room(other) for other in others} - {room(file)})

    assert "edge/core/press.py" in modules["edge/gateway/recorder.py"]
    TopologicalSorter(modules).prepare()
    TopologicalSorter(rooms).prepare()


def test_functions_fit_in_the_eye_and_files_have_one_subject(trees: dict[str, ast.Module]) -> None:
    """From `def` to the end without the docstring, and all lines of a file."""
    long = {file for file in trees if len((ROOT / file).read_bytes().splitlines()) > MAX_FILE_LINES}
    for file, tree in trees.items():
        for node in statements(tree):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node, clean=False) is not None else node.body
                heading = node.body[0].lineno - node.lineno
                lines = heading + (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else heading
                long |= {f"{file}:{node.name}"} if lines > MAX_FUNCTION_LINES else set()

    assert long == set()
