"""Which functions a running station may call: what no name reaches from `gelgate run`, and from the plugins and
features that it opens, is of other verbs, such as `gelgate station history`.

A name stands for everything that has it, so rather too much counts as the station's than too little.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
START = "edge.cli.run"
OPENED = ("devices", "overviews", "features", "sinks", "triggers", "actuators", "handshakes")
"""Entry points that a station opens."""


@dataclass(frozen=True)
class Function:
    """A function, or a method, with all in it. owner: the class of a method."""

    path: Path
    node: ast.FunctionDef | ast.AsyncFunctionDef
    owner: ast.ClassDef | None

    @property
    def has_no_caller(self) -> bool:
        """The interpreter calls it, or what decorates it, or what its class is a kind of."""
        decorators = {ast.unparse(one) for one in self.node.decorator_list}
        is_others = self.owner is not None and bool(self.owner.bases)
        is_special = self.node.name.startswith("__")
        return is_others or is_special or bool(decorators - {"property", "classmethod", "staticmethod"})

    @property
    def lines(self) -> range:
        """All of its lines."""
        first = min([self.node.lineno, *(one.lineno for one in self.node.decorator_list)])
        return range(first, (self.node.end_lineno or first) + 1)


def find_station_functions() -> Iterator[Function]:
    """Find them in `edge` and `plugins`, from the first verb on."""
    points = [point for group in OPENED for point in entry_points(group=f"gelgate.{group}")]
    modules, names = {START, *(point.module for point in points)}, {"run", *(point.attr for point in points)}
    waiting: list[Function] = []
    read: set[str] = set()
    while new := modules - read:
        for module in sorted(new):
            path = _find(module)
            functions, rest = _split(path) if path else ((), ())
            waiting += functions
            for node in rest:
                names |= set(_names(node))
                modules |= set(_imports(node))
        read |= new
        while reached := [one for one in waiting if _is_reached(one, names)]:
            waiting = [one for one in waiting if not _is_reached(one, names)]
            yield from reached
            for one in reached:
                names |= set(_names(one.node))
                modules |= set(_imports(one.node))


def _is_reached(function: Function, names: set[str]) -> bool:
    is_called = function.has_no_caller or function.node.name in names
    return is_called and (function.owner is None or function.owner.name in names)


def _find(module: str) -> Path | None:
    """Find the file of a module of ours."""
    path = ROOT.joinpath(*module.split("."))
    files = (path.with_suffix(".py"), path / "__init__.py")
    is_ours = module.split(".")[0] in ("edge", "plugins")
    return next((file for file in files if is_ours and file.is_file()), None)


def _split(path: Path) -> tuple[list[Function], list[ast.AST]]:
    """Return the functions of a file, and what runs when it is imported."""
    functions, rest = list[Function](), list[ast.AST]()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        owner = node if isinstance(node, ast.ClassDef) else None
        rest += [*owner.bases, *owner.decorator_list] if owner else []
        for one in owner.body if owner else [node]:
            if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef):
                functions.append(Function(path, one, owner))
                rest += one.decorator_list
            else:
                rest.append(one)
    return functions, rest


def _names(node: ast.AST) -> Iterator[str]:
    """Give the names that code says, but those that it imports alone."""
    for one in ast.walk(node):
        if isinstance(one, ast.Name):
            yield one.id
        elif isinstance(one, ast.Attribute):
            yield one.attr


def _imports(node: ast.AST) -> Iterator[str]:
    """Give the modules that it imports, each with the packages that it is in."""
    found: list[str] = []
    for one in ast.walk(node):
        if isinstance(one, ast.Import):
            found += [alias.name for alias in one.names]
        elif isinstance(one, ast.ImportFrom) and one.module:
            found += [one.module, *(f"{one.module}.{alias.name}" for alias in one.names)]
    for name in found:
        words = name.split(".")
        yield from (".".join(words[: end + 1]) for end in range(len(words)))
