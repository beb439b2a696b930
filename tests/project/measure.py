"""The shape of the source in figures: `make measure`, or `python tests/project/measure.py [FOLDER OF A CHECKOUT]`.

Prints files per folder, imports between rooms, circles of modules and of rooms, the length of functions, and lines in
all. A room is what is directly in a package: a folder with all that is in it, or a file. Only `ast` is needed, so that
any commit can be measured. `test_shape.py` holds the limits.
"""

import ast
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from statistics import median

PACKAGES = ("edge", "plugins", "calibration", "export")

Graph = dict[str, set[str]]


@dataclass(frozen=True)
class Function:
    """Where a function is, and its lines from `def` to the end, without the docstring."""

    name: str
    lines: int


@dataclass(frozen=True)
class Shape:
    """What is measured of one checkout. files: lines of each file; imports: module -> the modules it imports."""

    files: Mapping[str, int]
    functions: tuple[Function, ...]
    imports: Mapping[str, set[str]]

    @property
    def rooms(self) -> Graph:
        """Room -> the other rooms that its files import from."""
        rooms: Graph = {}
        for file, others in self.imports.items():
            rooms.setdefault(_room(file), set()).update(
                _room(other) for other in others if _room(other) != _room(file)
            )
        return rooms


def measure(root: Path) -> Shape:
    """Read every Python file of the packages below `root`."""
    paths = [path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))]
    trees = {path.relative_to(root).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}
    return Shape(
        files={path.relative_to(root).as_posix(): len(path.read_bytes().splitlines()) for path in paths},
        functions=tuple(one for file, tree in trees.items() for one in _functions(file, tree)),
        imports={file: set(_imports(file, tree, trees.keys())) - {file} for file, tree in trees.items()},
    )


def circle(graph: Mapping[str, set[str]]) -> tuple[str, ...]:
    """One circle of a graph, its first name repeated at the end; empty when there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return tuple(error.args[1])
    return ()


def _functions(file: str, tree: ast.Module) -> Iterator[Function]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            docstring = node.body[0] if ast.get_docstring(node, clean=False) is not None else None
            yield Function(f"{file}:{node.name}", _lines(node) - (_lines(docstring) if docstring else 0))


def _lines(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def _imports(file: str, tree: ast.Module, files: Set[str]) -> Iterator[str]:
    """The files that a file imports, at its top or inside a function; a package counts as its `__init__.py`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            yield from [path for path in _meanings(name) if path in files][:1]


def _meanings(name: str) -> tuple[str, ...]:
    """The files that `a.b.c` can mean: the module or package `a.b.c`, else the name `c` of `a.b`."""
    module, parent = name.replace(".", "/"), name.rpartition(".")[0].replace(".", "/")
    return f"{module}.py", f"{module}/__init__.py", f"{parent}.py", f"{parent}/__init__.py"


def _folder(file: str) -> str:
    return file.rpartition("/")[0]


def _room(file: str) -> str:
    """The folder or file directly in a package that a file is, or is in."""
    return "/".join(file.split("/")[:2])


def report(shape: Shape) -> str:
    """The figures as text."""
    lengths = sorted(one.lines for one in shape.functions)
    longest = sorted(shape.functions, key=lambda one: -one.lines)[:5]
    per_folder = Counter(_folder(file) for file in shape.files)
    rooms = shape.rooms
    return "\n".join(
        [
            f"files {len(shape.files)}, lines {sum(shape.files.values())}, longest file {max(shape.files.values())}",
            f"functions {len(lengths)}: median {median(lengths):.0f}, p90 {lengths[len(lengths) * 9 // 10]}, "
            f"max {lengths[-1]}",
            *(f"  {one.lines:4} {one.name}" for one in longest),
            f"rooms {len(rooms)}, imports between rooms {sum(map(len, rooms.values()))}",
            f"circle of modules: {' > '.join(circle(shape.imports)) or 'none'}",
            f"circle of rooms: {' > '.join(circle(rooms)) or 'none'}",
            "files per folder",
            *(f"  {count:4} {folder}" for folder, count in sorted(per_folder.items())),
        ]
    )


if __name__ == "__main__":
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2]
    print(report(measure(root)))
