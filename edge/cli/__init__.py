"""The command line: one command `gelgate`, its verbs found through the entry points `gelgate.commands`.

A verb's module imports only typer at the top and everything heavy inside its function, so help stays instant.

Exit codes: EXIT_MEANINGS. After 2 or 3 a restart does not help: a person has to correct something first.
"""

import errno
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
        7: "`gelgate lab tradeoff --check`: a point has become worse than in the earlier run",
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

# The verbs of `gelgate --help` in the order of work, the station's first; those of other packages follow as "Others".
_SECTIONS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "Station": ("demo", "devices", "check", "run", "watch", "page", "gel", "history", "db", "station"),
        "Bundles": ("record", "fit", "evaluate", "export", "bundle"),
        "Research": ("lab",),
    }
)

_GROUP_HELP: Final[Mapping[str, str]] = MappingProxyType(
    {
        "station": "Set up a station, describe it, and look into it.",
        "bundle": "Acquire, inspect, verify, sign or carry over a bundle.",
        "lab": "Simulate, study accuracy, and train: the laboratory.",
    }
)

# Group to its verbs. Each still answers at the top for this version, with a hint; the entry points are flat.
_GROUPS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "station": ("overview", "reference", "acts", "replay", "describe", "topics", "docs", "install-service"),
        "bundle": ("acquire", "carry", "inspect", "verify", "sign", "keys", "wrap"),
        "lab": (
            "simulate", "calibrate", "msa", "study", "report", "recommend", "tradeoff", "detectability",
            "train-backbone", "evaluate-backbone", "evaluate-new-gel", "evaluate-scars",
        ),
    }
)  # fmt: skip

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
        others = sorted({*known} - {*ours} - {*_GROUP_OF})
        return (name for name in (*ours, *others) if name in known or name in _GROUPS)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _group(name: str) -> "_Verbs":
    return _Verbs(name=name, help=_GROUP_HELP[name], no_args_is_help=True, rich_markup_mode=None)


def _load(name: str) -> Any:
    app, verb = typer.Typer(rich_markup_mode=None), registry.command(name)
    if isinstance(verb, typer.Typer):
        app.add_typer(verb, name=name)
    else:
        app.command(name, cls=_Command)(verb)
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
        return super().parse_args(ctx, words)


class _Verbs(typer.core.TyperGroup):
    """The verbs of the top or of one group, in the order of work."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self._is_top = given["name"] not in _GROUPS
        self.commands = _LoadedVerbs(None if self._is_top else given["name"])  # type: ignore[assignment]  # only read

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """List the verbs that can be loaded, with a warning for each other one."""
        names = list(self.commands)
        for name in tuple(names):
            try:
                self.commands[name]
            except errors.ConfigError as error:
                names.remove(name)
                print(f"gelgate: warning: {error}", file=sys.stderr)
        return names

    def format_commands(self, ctx: typer.Context, formatter: Any) -> None:  # type: ignore[override]
        """Write the verbs, those of the top in sections."""
        names = self.list_commands(ctx)
        sections = {title: [name for name in names if name in verbs] for title, verbs in _SECTIONS.items()}
        others = [name for name in names if not any(name in verbs for verbs in sections.values())]
        room = formatter.width - 6 - max(map(len, names))
        for title, verbs in {**sections, "Others" if self._is_top else "Commands": others}.items():
            if verbs:
                with formatter.section(title):
                    formatter.write_dl(
                        [(name, self.commands[name].get_short_help_str(room)) for name in verbs]
                    )

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
        if error.filename is None and error.errno not in _DISK:
            raise
        where = error.filename or "the disk"
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
