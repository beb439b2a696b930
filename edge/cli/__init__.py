"""The command line: one command `gelgate`, its verbs found through the entry points `gelgate.commands`.

A verb's module is imported when the verb is called; the list of verbs is known without that, so help is instant.

Exit codes: EXIT_MEANINGS. After 2 or 3 a restart does not help: a person has to correct something first.
"""

import errno
import gc
import io
import os
import platform
import stat
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from types import MappingProxyType
from typing import Annotated, Any, Final, NoReturn

import typer

from edge import extras, registry
from edge.core import errors

_OURS = ("edge", "plugins", "calibration", "export")

__all__ = ["EXIT_CODES", "EXIT_MEANINGS", "build", "exit_code", "main", "place", "versions"]

EXIT_MEANINGS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0: "done",
        1: "the work failed: database, disk, a file that cannot be written, or a press without a score",
        2: "the command line is wrong",
        3: "a configuration, bundle, recording, dataset or set of nominal presses is wrong",
        4: "a sensor or broker is not available",
        5: "`gelgate bundle verify`: the bundle is not sound",
        6: "a recording was played, and the presses found are not the presses that it holds",
        8: "`gelgate station replay`: a verdict that is made again differs from the one that was given",
        130: "interrupted with Ctrl-C; `gelgate run`, `gelgate record` and `gelgate bundle acquire` end with 0 then",
    }
)

EXIT_CODES: Final[tuple[tuple[type[errors.GelgateError], int], ...]] = (
    (errors.ConfigError, 3),
    (errors.BundleError, 3),
    (errors.RecordingError, 3),
    (errors.DatasetError, 3),
    (errors.FitError, 3),
    (errors.DeviceError, 4),
    (errors.SinkError, 4),
    (errors.PressesMissed, 6),
    (errors.GelgateError, 1),
)

# The verbs of `gelgate --help` by section, in the order of work, and those of each group: verb to its line. They are
# listed without being loaded. Those of other packages follow as "Others".
_SECTIONS: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "Station": {
            "demo": "Simulate a bolt, fit a bundle, inspect, publish.",
            "new-part": "Guide from a sensor and good pieces to a running station.",
            "devices": "List the plugged-in cameras, pedals and relays.",
            "check": "Check all that `run` needs; report every fault.",
            "run": "Run the gateway: inspect every press and publish.",
            "watch": "Print verdicts as they arrive, each press once.",
            "gel": "Show the wear of gels, or record a replacement.",
            "history": "Show which presses were made.",
            "db": "Check, back up or migrate the gateway's database.",
            "station": "Set up a station, describe it, and look into it.",
        },
        "Bundles": {
            "record": "Record frames from a device, video or press images.",
            "fit": "Learn a bundle from nominal presses.",
            "evaluate": "Score a bundle on a dataset: metrics and report.",
            "export": "Import trained backbones, or write graphs.",
            "bundle": "Acquire, inspect, verify, sign, carry over or teach a bundle.",
        },
        "Research": {
            "lab": "Simulate, study accuracy, and train: the laboratory.",
            "new": "Write a sink, device, detector or feature to begin with.",
        },
    }
)

# Each of these verbs still answers at the top for this version, with a hint; the entry points are flat.
_GROUPS: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "station": {
            "page": "Serve the page of a station from a broker.",
            "overview": "Print what one still of the overview camera shows.",
            "reference": "Press a master piece, or show its control charts.",
            "acts": "Show who asked the station for what.",
            "replay": "Make verdicts again, bit for bit.",
            "heights": "Measure a press in millimetres.",
            "describe": "Describe a station to other programs.",
            "topics": "Print every MQTT topic and field, as in docs/mqtt.md.",
            "docs": "List the pages of the manual, or print one.",
            "install-service": "Install the systemd unit and the udev rule.",
        },
        "bundle": {
            "acquire": "Take nominal presses until they are enough, then fit.",
            "carry": "Carry a bundle over to a new gel of its sensor.",
            "learn": "Learn from what people said at the station.",
            "teach": "Teach a bundle damage that it missed.",
            "regions": "Draw where a bundle judges, ignores, or is stricter.",
            "inspect": "Show what a bundle contains, from its manifest.",
            "verify": "Check a bundle's files and its scores on this machine.",
            "sign": "Sign a bundle, so that a gateway can tell who made it.",
            "keys": "Make and show the keys that bundles are signed with.",
            "wrap": "Make a bundle of another tool's detector graph.",
        },
        "lab": {
            "simulate": "Simulate presses as a dataset or as recordings.",
            "calibrate": "Calibrate a sensor with its gel, from presses of a ball.",
            "msa": "Measurement systems analysis: a gauge study.",
            "study": "Study what accuracy costs, cell by cell.",
            "report": "Make a study's page and figures from its rows.",
            "recommend": "Say which method to take for a need, from rows alone.",
            "tradeoff": "Measure what accuracy costs: time, memory, presses.",
            "bench": "Measure a station, from frame to subscriber.",
            "detectability": "Measure the smallest damage found, by place.",
            "train-backbone": "Train the tactile backbone on simulated presses.",
            "evaluate-backbone": "Compare backbones on presses that training never draws.",
            "month": "A month on the line: dust, wear, drift, a person.",
        },
    }
)

_LINES: Final[Mapping[str, str]] = {
    verb: line for verbs in (*_SECTIONS.values(), *_GROUPS.values()) for verb, line in verbs.items()
}
_GROUP_OF: Final = {verb: group for group, verbs in _GROUPS.items() for verb in verbs}

# Errors of a disk that is full, read-only or faulty; such an error names no file.
_DISK: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


# What a shell connects to other programs or to nothing.
_STREAMS: Final = ("/dev/null", "/dev/std", "/dev/fd/", "/dev/tty", "/dev/pts/")


class _LoadedVerbs(Mapping[str, Any]):
    """Name to verb; a verb is loaded when it is asked for, so that one that cannot be loaded stops no other."""

    def __init__(self, group: str | None) -> None:
        self._group = group
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        """The command of typer; a function becomes one, a `Typer` becomes a group. Errors: ConfigError."""
        if name not in self._loaded:
            is_moved = self._group is None and name in registry.names("commands")
            if not is_moved and name not in list(self):
                raise KeyError(name)
            self._loaded[name] = _group(name) if name in _GROUPS else _load(name)
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        """List the verbs in the order of the help, those of other packages last, by name."""
        known = registry.names("commands")
        if self._group:
            return (name for name in _GROUPS[self._group] if name in known)
        ours = [name for names in _SECTIONS.values() for name in names]
        return (name for name in (*ours, *sorted({*known} - {*_LINES})) if name in known or name in _GROUPS)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _group(name: str) -> "_Verbs":
    return _Verbs(name=name, help=_LINES[name], no_args_is_help=True, rich_markup_mode=None)


def _load(name: str) -> Any:
    app, verb = typer.Typer(rich_markup_mode=None), registry.command(name)
    if isinstance(verb, typer.Typer):
        app.add_typer(verb, name=name)
    else:
        app.command(name, cls=_Command)(verb)
    if not gc.isenabled():  # as `gelgate.main` leaves it
        gc.freeze()
        gc.enable()
    return typer.main.get_group(app).commands[name]


class _Command(typer.core.TyperCommand):
    """A verb; `--set NAME=VALUE` gives each option that its help does not show."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Write `--set seed=3` as `--seed=3` before anything is read."""
        hidden = {option.name: option for option in self.params if getattr(option, "hidden", False)}
        words, rest = [], iter(args)
        for word in rest:
            given = next(rest, "") if word == "--set" else word.removeprefix("--set=")
            name, sign, value = (part.strip() for part in given.partition("="))
            if not word.startswith("--set") or not sign or name not in hidden:
                words += [word, given] if word == "--set" else [word]
            elif not getattr(hidden[name], "is_flag", False):
                words.append(f"{hidden[name].opts[0]}={value}")
            elif value in ("true", "false"):
                words += hidden[name].opts[:1] if value == "true" else hidden[name].secondary_opts[:1]
            else:
                ctx.fail(f"'--set {given}' is not understood; write {name}=true or {name}=false")
        takes = {param.name: param.param_type_name for param in self.params}
        if words and words[0].endswith(".toml") and "config" in takes and "argument" not in takes.values():
            ctx.fail(f"'{words[0]}' stands alone; a configuration is given as --config {words[0]}")
        return super().parse_args(ctx, words)


class _Verbs(typer.core.TyperGroup):
    """The verbs of the top or of one group, in the order of work."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self._is_top = given["name"] not in _GROUPS
        self.commands = _LoadedVerbs(None if self._is_top else given["name"])  # type: ignore[assignment]  # only read

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """List the verbs; one of another package that cannot be loaded is left out, with a warning."""
        names = list(self.commands)
        for name in {*names} - {*_LINES}:
            try:
                self.commands[name]
            except errors.ConfigError as error:
                names.remove(name)
                print(f"gelgate: warning: {error}", file=sys.stderr)
        return names

    def shell_complete(self, ctx: typer.Context, incomplete: str) -> Any:  # type: ignore[override]
        """Suggest verbs, without loading ours."""
        listed = [typer.core.TyperCommand(name, help=self._line(name)) for name in self.list_commands(ctx)]
        group = typer.core.TyperGroup(name=self.name, commands=listed, params=self.params)
        return group.shell_complete(typer.Context(group), incomplete)

    def _line(self, name: str) -> str:
        return _LINES.get(name) or self.commands[name].get_short_help_str(100)

    def format_commands(self, ctx: typer.Context, formatter: Any) -> None:  # type: ignore[override]
        """Write the verbs, those of the top in sections."""
        names = self.list_commands(ctx)
        sections = {title: [name for name in names if name in verbs] for title, verbs in _SECTIONS.items()}
        others = [name for name in names if not any(name in verbs for verbs in sections.values())]
        for title, verbs in {**sections, "Others" if self._is_top else "Commands": others}.items():
            if verbs:
                with formatter.section(title):
                    formatter.write_dl([(name, self._line(name)) for name in verbs])

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        """Find the verb; a name that has moved into a group is found too, with a hint."""
        if self._is_top and args[0] in _GROUP_OF and not ctx.resilient_parsing:
            hint = (
                f"'gelgate {args[0]}' is now 'gelgate {place(args[0])}'; the old name ends with this version"
            )
            print(f"gelgate: hint: {hint}", file=sys.stderr)
        return super().resolve_command(ctx, args)


def place(verb: str) -> str:
    """The words after `gelgate` for an entry point of `gelgate.commands`, such as `lab study` for `study`."""
    return f"{_GROUP_OF[verb]} {verb}" if verb in _GROUP_OF else verb


def build() -> typer.Typer:
    """The application with every registered verb."""
    app = typer.Typer(
        name="gelgate",
        cls=_Verbs,
        help="Touch inspection at the edge: score GelSight Mini presses, publish verdicts, count gel wear.",
        no_args_is_help=True,
        epilog="Exit codes: " + " · ".join(f"{code} {meaning}" for code, meaning in EXIT_MEANINGS.items()),
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_options)
    return app


def _print_versions(is_wanted: bool) -> None:
    if is_wanted:
        typer.echo("\n".join(versions()))
        raise typer.Exit


def _options(
    is_version_wanted: Annotated[
        bool,
        typer.Option(
            "--version",
            "-V",
            callback=_print_versions,
            is_eager=True,
            help="Print the versions to name in a fault report.",
        ),
    ] = False,
) -> None:
    pass


def versions() -> Iterator[str]:
    """The versions to name in a fault report, one per line; from metadata, so that nothing is imported."""
    yield f"gelgate {version('gelgate')}"
    yield f"python {platform.python_version()} ({platform.system()} {platform.machine()})"
    for name in ("onnxruntime", "numpy"):
        yield f"{name} {version(name)}"


def exit_code(error: type[errors.GelgateError]) -> int:
    """The exit code of a refusal."""
    return next(code for kind, code in EXIT_CODES if issubclass(error, kind))


def main() -> NoReturn:
    """Run the command line; every refusal is one sentence on stderr and a documented exit code."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who starts it: no file may get its number
            null = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(null, "r" if name == "stdin" else "w", encoding="utf-8"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what a terminal cannot spell ends nothing
            stream.reconfigure(errors="backslashreplace")
    for word in filter(_is_endless, sys.argv[1:]):
        print(f"gelgate: {word} is neither a file nor a folder; give one of them", file=sys.stderr)
        sys.exit(2)
    try:
        build()()
    except errors.GelgateError as error:
        print(f"gelgate: {error}", file=sys.stderr)
        sys.exit(exit_code(type(error)))
    except ImportError as error:
        hidden = registry.hidden_package(error.name or "")
        is_memory_short = "failed to map segment" in str(
            error
        )  # the loader's words where an address space is full
        if hidden is None and not is_memory_short:
            package = (error.name or "").partition(".")[0]
            if not isinstance(error, ModuleNotFoundError) or package in _OURS:
                raise
            hidden = f"this needs the package {package}, not installed here; {extras.where_to_get(package)}"
        print(f"gelgate: {hidden or f'{error}; allow more memory (`ulimit -v`, LimitAS=)'}", file=sys.stderr)
        sys.exit(exit_code(errors.ConfigError) if hidden else 1)
    except OSError as error:
        # a working folder that is gone has no name either
        nameless = {errno.ENOENT: "the folder where this was started", **dict.fromkeys(_DISK, "the disk")}
        where = error.filename or nameless.get(error.errno or 0)
        if where is None:
            raise
        print(
            f"gelgate: {where}: {error.strerror}; check the path, its rights and the free space",
            file=sys.stderr,
        )
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(_interrupted())
    except SystemExit as end:
        sys.exit(_interrupted() if end.code == 130 else end.code)  # typer ends silently on Ctrl-C
    sys.exit(0)


def _is_endless(word: str) -> bool:
    """Tell whether a word names a pipe or a device: a verb that reads it may wait for ever."""
    name = word.partition("=")[2] if word.startswith("--") else word
    try:
        kind = stat.S_IFMT(os.stat(name).st_mode)
    except (OSError, ValueError):
        return False
    return kind not in (stat.S_IFREG, stat.S_IFDIR) and not name.startswith(_STREAMS)


def _interrupted() -> int:
    print("gelgate: interrupted", file=sys.stderr)
    return 130
