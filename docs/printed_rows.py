"""Rows, tables and texts of the pages that are printed from the program."""

import ast
import inspect
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).parent
NOTICE: Final = "<!-- Printed from the program by `make docs`; change the program, not this page. -->\n"


def table(heading: Sequence[str], rows: Iterable[Sequence[str | None]]) -> Iterator[str]:
    """Write a table after an empty line."""
    yield from ("", row(*heading), row(*("---" for _ in heading)))
    yield from (row(*cells) for cells in rows)


def row(*cells: str | None) -> str:
    """Write a row of a table."""
    return "| " + " | ".join(map(cell, cells)) + " |"


def cell(text: str | None) -> str:
    """Write a text in one line, without what would end a cell."""
    return " ".join((text or "").replace("|", "\\|").split())


def paragraphs(text: str | None) -> str:
    """Write a docstring as Markdown: lines that belong together joined."""
    return "\n\n".join(" ".join(part.split()) for part in (text or "").split("\n\n"))


def number(value: float) -> str:
    """Write a number."""
    return f"{value:,.0f}" if value == round(value) else f"{value:g}"


def explain(kind: type) -> Iterator[tuple[str, str]]:
    """Yield the fields of one class, each with the text under it, where `docs/page.md#section` becomes a link."""
    body = ast.parse(inspect.getsource(kind)).body[0].body  # type: ignore[attr-defined]
    for field, text in pairwise(body):
        if isinstance(field, ast.AnnAssign | ast.Assign) and isinstance(text, ast.Expr):
            name = field.target if isinstance(field, ast.AnnAssign) else field.targets[0]
            linked = re.sub(r"docs/([\w-]+\.md)([#\w-]*)", r"[\1](\1\2)", ast.literal_eval(text.value))
            yield f"`{ast.unparse(name)}`", linked


def print_again(name: str, tables: Mapping[str, Iterable[str]]) -> str:
    """Return a page as it is, with the lines between its marks printed again. tables: by what they are printed from."""
    page, end = (FOLDER / name).read_text(encoding="utf-8"), "<!-- end -->\n"
    for source, lines in tables.items():
        start = f"<!-- printed from {source} -->\n"
        before, _, rest = page.partition(start)
        page = before + start + "\n".join([*lines, ""]) + "\n" + end + rest.partition(end)[2]
    return page
