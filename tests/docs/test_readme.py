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
APP = typer.main.get_command(build())
TARGETS = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


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
        return None if all(word in TARGETS for word in words[1:]) else "no such target"
    command: Any = APP
    for position, word in enumerate(words[1:], 1):
        if not hasattr(command, "commands"):
            return option_fault(command, words[position:])
        if word in ("--help", "VERB"):
            return None
        if word in [name for one in command.params for name in one.opts]:
            return None
        if word not in command.commands:
            return f"no command '{word}'"
        command = command.commands[word]
    return None


def option_fault(command: Any, words: list[str]) -> str | None:
    """Every option exists and has its value; there are as many arguments as the command takes."""
    options = {name: one for one in command.params for name in (*one.opts, *one.secondary_opts)}
    arguments = 0
    rest = iter(words)
    for word in rest:
        if not word.startswith("-"):
            arguments += 1
        elif word.partition("=")[0] == "--help":
            continue
        elif word.partition("=")[0] not in options:
            return f"no option {word}"
        elif "=" not in word and not getattr(options[word], "is_flag", False) and next(rest, None) is None:
            return f"{word} without its value"
    takes = [one for one in command.params if one.param_type_name == "argument"]
    if arguments > len(takes) and not any(one.nargs == -1 for one in takes):
        return f"{arguments} arguments, it takes {len(takes)}"
    return None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_on_the_pages_exist(page: Path) -> None:
    """Verb, options and number of arguments, as the program knows them."""
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
    """The check can fail."""
    assert fault(line) is not None
