"""Every command that README.md and the pages of docs/ show is one that the program has."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from edge.cli import build

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "firmware_notes").glob("*.md")),
]
PRINTED = "printed from the program"
APP: Any = typer.main.get_command(build())
TARGETS = re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def fenced(page: Path) -> Iterator[str]:
    """Lines of fenced blocks, without their comments; a line that ends with a backslash goes on in the next."""
    is_inside = False
    for line in page.read_text(encoding="utf-8").replace("\\\n", "").splitlines():
        if line.lstrip().startswith("```"):
            is_inside = not is_inside
        elif is_inside:
            yield line.partition(" #")[0].strip().removeprefix("$ ")


def spoken(page: Path) -> Iterator[str]:
    """Commands in running text, between backquotes."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    yield from (" ".join(words.split()) for words in re.findall(r"`((?:gelgate|make) [^`]+)`", text))


def shown(page: Path) -> list[str]:
    is_printed = PRINTED in page.read_text(encoding="utf-8").partition("\n")[0].lower()
    lines = [] if is_printed else [*fenced(page), *spoken(page)]
    return [line for line in lines if re.match(r"(\S+/)?(gelgate|make) ", line)]


def fault(line: str) -> str | None:
    """Why the program has no such command, None if it has."""
    words = shlex.split(line.partition(" > ")[0])
    if words[0] == "make":
        return (
            None if all(word in TARGETS or word.startswith("--") for word in words[1:]) else "no such target"
        )
    command, words = APP, words[1:]
    while hasattr(command, "commands"):
        if not words or words[0] in ("VERB", *(name for one in command.params for name in one.opts)):
            return None
        if words[0] not in command.commands:
            return f"no command '{words[0]}'"
        command, words = command.commands[words[0]], words[1:]
    try:
        parser = command.make_parser(command.context_class(command))
        left = parser.parse_args([word for word in words if word != "--help"])[1]
    except Exception as error:  # noqa: BLE001 - of the library that typer has inside
        return str(error)
    return f"arguments that it does not take: {left}" if left else None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_on_the_pages_exist(page: Path) -> None:
    assert {line: why for line in shown(page) if (why := fault(line)) is not None} == {}


def test_continuous_integration_runs_the_commands_of_the_readme() -> None:
    """Its first commands are the README's two, as they are written there; nothing is installed or set before them."""
    readme = [line for line in fenced(ROOT / "README.md") if line.startswith("make ")]
    run = [line for line in (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines() if "make " in line]

    assert readme == ["make demo", "make test"]
    assert run[:2] == readme
    assert [fault(line) for line in run] == [None] * len(run)


@pytest.mark.parametrize(
    "line",
    [
        "gelgate rnu",
        "gelgate run --confg x",
        "gelgate fit nominal --part",
        "gelgate gel shw",
        "gelgate bundle verify a b",
        "make dmo",
    ],
)
def test_a_command_that_does_not_exist_is_noticed(line: str) -> None:
    assert fault(line) is not None
