"""Documentation is tested: printed pages are those of the program, and every name is explained in docs/."""

import importlib
import re
from pathlib import Path

import pytest
from scripts import load_script

from edge.cli import EXIT_CODES, EXIT_MEANINGS
from edge.cli.run import example
from edge.clock import SystemClock
from edge.config import Config, load_config
from edge.core import errors
from edge.gateway.command_table import every_command, station_handlers
from edge.gateway.loop_calls import LoopCalls

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


GENERATE = load_script("docs/generate.py")
PRINTED = {name: (DOCS / name).read_text(encoding="utf-8") for name in GENERATE.PAGES}


def test_what_is_installed_is_this_tree() -> None:
    """Else a new verb or plugin would vanish from the pages when they are printed."""
    assert GENERATE.find_missing() == [], "run `pip install -e . --no-deps`"


@pytest.mark.parametrize("name", GENERATE.PAGES)
def test_a_printed_page_is_the_programs(name: str) -> None:
    """After a change of a command, key, error or topic the pages are printed again: `make docs`."""
    assert PRINTED[name] == GENERATE.PAGES[name](), "run `make docs`"


IMPORT = re.compile(r"^ *from ((?:edge|calibration|export|plugins)[\w.]*) import ([\w, ]+)$", re.MULTILINE)
IMPORTS = [
    (page.name, module, name)
    for page in sorted([*DOCS.glob("*.md"), ROOT / "README.md"])
    for module, names in IMPORT.findall(page.read_text(encoding="utf-8"))
    for name in names.split(", ")
]


@pytest.mark.parametrize(("page", "module", "name"), IMPORTS)
def test_what_an_example_imports_is_there(page: str, module: str, name: str) -> None:
    assert hasattr(importlib.import_module(module), name), f"docs/{page}: {module} has no {name}"


def test_every_key_says_what_it_means() -> None:
    rows = [line for line in PRINTED["config.md"].splitlines() if line.startswith("| `")]

    assert len(rows) > 30
    assert [row for row in rows if re.search(r"\|\s*\|$", row)] == []


def test_every_command_verb_is_in_the_manual() -> None:
    """What a running station answers to is the table that the page prints, with every argument of every verb."""
    handlers = station_handlers(LoopCalls(SystemClock()), every_command())
    rows = {line.split("`")[1]: line for line in PRINTED["mqtt.md"].splitlines() if line.startswith("| `")}

    assert set(handlers) == {command.verb for command in every_command()}
    for command in every_command():
        assert command.help in rows[command.verb]
        assert [
            name for name in command.arguments.model_fields if f"`{name}`" not in rows[command.verb]
        ] == []


def test_every_error_is_in_the_manual_and_in_the_tree() -> None:
    """The tree names each class once, below its own base, and says whose fault it is and what comes next."""
    drawn = [kind for kind, _, _ in GENERATE.tree()]

    assert sorted(kind.__name__ for kind in drawn) == sorted(
        {name for name in vars(errors) if name[0].isupper()} - {"GelgateError"}
    )
    above: dict[int, type] = {0: errors.GelgateError}
    for line in (errors.__doc__ or "").splitlines():
        found = re.match(r"([│ ]*)[├└]── (\w+)", line)
        if found:
            depth = len(found[1]) // 4 + 1
            kind = getattr(errors, found[2])
            assert above[depth - 1] in kind.__bases__, line
            above[depth] = kind
    assert [kind.__name__ for kind in drawn if f"`{kind.__name__}`" not in PRINTED["errors.md"]] == []


def test_every_exit_code_is_in_the_manual() -> None:
    """Every code that a refusal can have is explained, and every explained code is printed."""
    assert {code for _, code in EXIT_CODES} <= set(EXIT_MEANINGS)
    assert [
        code for code, meaning in EXIT_MEANINGS.items() if f"| {code} | {meaning} |" not in PRINTED["cli.md"]
    ] == []


def test_the_example_is_a_sound_configuration_with_every_table(tmp_path: Path) -> None:
    """What `gelgate check --example` prints can be read, and shows every table."""
    (tmp_path / "gelgate.toml").write_text(example(), encoding="utf-8")
    config = load_config(tmp_path / "gelgate.toml")

    assert config.model_fields_set == set(Config.model_fields)
    assert config.station.model_fields_set == set(type(config.station).model_fields)


LINK = re.compile(r"\]\(([^)\s]+)\)")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    """Every relative link of a page names a file or folder that is there, and a section of it."""
    links = {link for link in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link}

    assert [link for link in sorted(links) if not leads(page, link)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_of_the_program_that_a_page_names_are_there(page: Path) -> None:
    """A reader finds what a page calls `edge/...` or `tests/...`."""
    named = re.findall(
        r"(?<![\w/.-])((?:edge|plugins|calibration|export|tests)/[\w./-]*\w)", page.read_text("utf-8")
    )

    assert [name for name in sorted(set(named)) if not (ROOT / name).exists()] == []


def test_sections_that_the_program_names_are_there() -> None:
    """Messages and comments of the program point at pages too."""
    text = "".join(file.read_text(encoding="utf-8") for room in ROOMS for file in (ROOT / room).rglob("*.py"))

    assert [
        link
        for link in sorted(set(re.findall(r"docs/[\w/-]+\.md(?:#[\w-]+)?", text)))
        if not leads(ROOT / "README.md", link)
    ] == []


ROOMS = ("edge", "plugins", "calibration", "export")


def leads(page: Path, link: str) -> bool:
    name, _, section = link.partition("#")
    target = page.parent / name if name else page
    return target.exists() and (not section or section in anchors(target))


def anchors(page: Path) -> set[str]:
    """Return what `#` can be followed by: headings, as GitHub writes them, and named places."""
    text = page.read_text(encoding="utf-8")
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles} | set(
        re.findall(r'<a id="([\w-]+)"', text)
    )
