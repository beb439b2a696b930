"""`gelgate --help` and `gelgate VERB --help`: complete, quick, and without anything heavy."""

import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, NoReturn

import pytest
import typer
from command_line import gelgate

from edge import cli, registry
from edge.cli import EXIT_MEANINGS, build, place

# 270 are usual. What a page of help costs is what it imports, on a gateway's slow processor too.
MOST_MODULES = 400


def commands(command: Any = None, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command and group with its path."""
    command = command or typer.main.get_command(build())
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*path, name))


ALL = dict(commands())


@pytest.mark.parametrize("path", ALL, ids=lambda path: "gelgate " + " ".join(path))
def test_what_a_command_takes_is_in_its_help(path: tuple[str, ...]) -> None:
    """Every option and argument has a text, is printed, and help ends with 0."""
    ended, command = gelgate(*path, "--help"), ALL[path]

    assert ended.code == 0, ended.err
    assert command.help
    shown = [one for one in command.params if not getattr(one, "hidden", False)]
    options = [name for one in shown for name in one.opts if name.startswith("-")]
    assert [name for name in options if name not in ended.out] == []
    assert [one.name for one in command.params if not (one.help or "").strip()] == []


def test_the_first_page_tells_the_exit_codes() -> None:
    """The author of a script finds them next to the verbs."""
    words = " ".join(gelgate("--help").out.split())

    assert [code for code, meaning in EXIT_MEANINGS.items() if f"{code} {meaning}" not in words] == []


def listed(*path: str) -> dict[str, str]:
    """Verb to its line, as the help of `gelgate` or of a group lists them."""
    return {verb: line for lines in sections(*path).values() for verb, line in lines.items()}


def sections(*path: str) -> dict[str, dict[str, str]]:
    """Title to the verbs below it, with their lines."""
    titled = re.findall(r"^(\w+):\n((?:  .+\n)+)", gelgate(*path, "--help").out, re.MULTILINE)
    return {
        title: {line.split()[0]: line for line in lines.splitlines()}
        for title, lines in titled
        if title not in ("Options", "Arguments")
    }


def test_no_line_of_a_verb_is_cut_at_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each verb's line is complete on a terminal of the usual width, in the help of a group too, and is its own."""
    monkeypatch.setenv("COLUMNS", "80")
    lines = {(*path, verb): line for path in ALL for verb, line in listed(*path).items()}

    assert set(lines) == {path for path in ALL if path}
    assert [path for path, line in lines.items() if not line.endswith(ALL[path].get_short_help_str(80))] == []


def test_the_first_page_has_few_verbs_in_sections() -> None:
    """The station's first; every verb is in a section or in a group."""
    found = sections()

    assert list(found) == ["Station", "Bundles", "Research"]
    assert sum(map(len, found.values())) <= 17
    assert list(found["Station"])[:4] == ["demo", "new-part", "devices", "check"]
    assert {(*place(name).split(),) for name in registry.names("commands")} <= set(ALL)


@pytest.mark.parametrize("name", [name for name in registry.names("commands") if place(name) != name])
def test_a_verb_that_has_moved_answers_to_its_old_name(name: str) -> None:
    """With a hint on the error output; what is printed otherwise is the same but for the name."""
    old, new = gelgate(name, "--help"), gelgate(*place(name).split(), "--help")

    assert old.err == (
        f"gelgate: hint: 'gelgate {name}' is now 'gelgate {place(name)}'; the old name ends with this version\n"
    )
    assert (old.code, new.code, new.err) == (0, 0, "")
    assert " ".join(old.out.split()) == " ".join(new.out.split()).replace(place(name), name, 1)


def test_a_verb_of_another_package_has_a_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is at the top, last."""
    (tmp_path / "lamp.py").write_text("def lamp() -> None:\n    'Switch a lamp.'\n")
    monkeypatch.syspath_prepend(tmp_path)
    points = {**registry._points("commands"), "lamp": [EntryPoint("lamp", "lamp:lamp", "gelgate.commands")]}
    known = registry._points
    monkeypatch.setattr(registry, "_points", lambda group: points if group == "commands" else known(group))

    assert list(sections().items())[-1] == ("Others", {"lamp": "  lamp  Switch a lamp."})
    assert gelgate("lamp").code == 0


@pytest.mark.parametrize("value", ["no_such_package.lamp:main", "broken_lamp:main", "math:pi"])
def test_a_broken_verb_stops_no_other(value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not in the list, with a warning; the other verbs and `--version` do not mention it; it ends with 3."""
    (tmp_path / "broken_lamp.py").write_text("raise RuntimeError('no lamp')")
    monkeypatch.syspath_prepend(tmp_path)
    points = {**registry._points("commands"), "lamp": [EntryPoint("lamp", value, "gelgate.commands")]}
    known = registry._points
    monkeypatch.setattr(registry, "_points", lambda group: points if group == "commands" else known(group))

    first = gelgate("--help")
    assert (first.code, "fit" in first.out, "lamp" in first.out) == (0, True, False)
    assert first.err.startswith("gelgate: warning: the ")
    assert "'lamp'" in first.err
    assert [gelgate(*words).err for words in (["--version"], ["station", "topics"])] == ["", ""]
    assert gelgate("lamp").code == 3
    assert "'lamp'" in gelgate("lamp").sentence()


def test_a_folder_that_hides_our_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another `export` on PYTHONPATH is the fault, not a package that is missing."""
    (tmp_path / "export").mkdir()
    (tmp_path / "export/__init__.py").touch()
    monkeypatch.delitem(sys.modules, "export", raising=False)
    monkeypatch.syspath_prepend(tmp_path)

    assert registry.hidden_package("export.command") == (
        f"{tmp_path}/export hides gelgate's own package 'export'; rename it, or take {tmp_path} off PYTHONPATH"
    )
    assert registry.hidden_package("edge.cli") is None
    assert registry.hidden_package("no_such_package") is None


@pytest.mark.parametrize(
    ("package", "advice"), [("jinja2", "pip install 'gelgate[studies]'"), ("tqdm", "pip install tqdm, or")]
)
def test_a_missing_package_is_one_sentence(
    package: str, advice: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def build() -> NoReturn:
        raise ModuleNotFoundError(f"No module named '{package}'", name=package)

    monkeypatch.setattr(cli, "build", build)
    with pytest.raises(SystemExit, match="3"):
        cli.main()
    assert (
        f"gelgate: this needs the package {package}, not installed here; {advice}" in capsys.readouterr().err
    )


def test_a_folder_that_hides_the_command_line_itself_is_named(tmp_path: Path) -> None:
    """Nothing of `edge` can be loaded then, so the sentence comes from outside."""
    (tmp_path / "edge").mkdir()
    (tmp_path / "edge/__init__.py").touch()
    root = Path(__file__).resolve().parents[2]
    code = (
        "import sys; sys.meta_path[:] = [one for one in sys.meta_path if 'Editable' not in repr(one)]\n"
        f"sys.path[:0] = [{str(tmp_path)!r}, {str(root)!r}]; import gelgate; gelgate.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)

    assert (done.returncode, done.stdout) == (3, "")
    assert f"{tmp_path}/edge hides gelgate's own package 'edge'" in done.stderr


def test_a_shell_suggests_verbs() -> None:
    group = typer.main.get_command(build())
    context = group.make_context("gelgate", [], resilient_parsing=True)

    assert [(one.value, one.help) for one in group.shell_complete(context, "ex")] == [
        ("export", "Import trained backbones, or write graphs.")
    ]


def test_help_loads_nothing_heavy() -> None:
    """Neither arrays nor pictures, runtimes nor models are imported to print a page of text, and it costs little."""
    code = (
        "import sys; from edge.cli import main\n"
        "sys.argv = ['gelgate', '--help']\n"
        "try: main()\n"
        "finally: print('loaded:', *sorted(sys.modules))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.rpartition("loaded:")[2].split())

    assert (
        loaded & {"numpy", "cv2", "onnxruntime", "onnx", "torch", "pydantic", "paho", "usb", "sqlite3"}
        == set()
    )
    assert 100 < len(loaded) < MOST_MODULES


@pytest.mark.parametrize("verb", ["check", "run", "history"])
def test_a_configuration_without_its_option_is_told_where_it_belongs(verb: str) -> None:
    """Who is in a hurry writes `gelgate check station.toml`."""
    done = gelgate(verb, "station.toml")
    assert done.code == 2
    assert "'station.toml' stands alone; a configuration is given as --config station.toml" in done.err
