"""Prints docs/cli.md: every verb with its arguments, options and defaults."""

import inspect
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import NoneType
from typing import Any, Final, get_args, get_origin, get_type_hints

import typer
from printed_rows import NOTICE, number, paragraphs, table

from edge import registry
from edge.cli import EXIT_MEANINGS, place

_ABOUT: Final = f"""{NOTICE}
# Command line

A reference. Refusals are one sentence on the standard error output; results go to the standard output."""
_ERRORS: Final = "\n[errors.md](errors.md) says which error gives which code.\n"
_OPTION: Final = ("option", "default", "what it is")


def cli_page() -> str:
    """Every verb with its arguments, options and defaults, and the exit codes."""
    every = {
        path: [parameter for parameter in parameters(verb) if not parameter.is_hidden]
        for path, verb in verbs()
    }
    shared = _shared(chain.from_iterable(every.values()))
    common = ["## Options of several verbs", *table(_OPTION, (one.cells() for one in shared)), ""]
    sections = (_section(path, verb, every[path], shared) for path, verb in verbs())
    codes = table(("exit code", "meaning"), ((str(code), text) for code, text in EXIT_MEANINGS.items()))
    return "\n".join([_ABOUT, *codes, _ERRORS, *common, *sections])


def _shared(every: Iterable["Parameter"]) -> list["Parameter"]:
    """Return the options that mean the same in at least three verbs, one of a name."""
    counts = Counter(one for one in every if not one.is_argument)
    found = {one.names[0]: one for one, count in reversed(counts.most_common()) if count >= 3}
    return [found[name] for name in sorted(found)]


def verbs() -> Iterator[tuple[str, Callable[..., None]]]:
    """Every command with its words, such as `gelgate gel show`."""
    for name in sorted(registry.names("commands"), key=place):
        verb = registry.command(name)
        if isinstance(verb, typer.Typer):
            for command in verb.registered_commands:
                if command.callback is not None:
                    yield (
                        f"gelgate {place(name)} {command.name or command.callback.__name__.replace('_', '-')}",
                        command.callback,
                    )
        else:
            yield f"gelgate {place(name)}", verb


@dataclass(frozen=True)
class Parameter:
    """One argument or option of a verb, from its signature."""

    names: tuple[str, ...]
    value: str
    default: str
    help: str
    is_argument: bool
    is_hidden: bool = False

    @classmethod
    def of(cls, name: str, annotation: Any, default: Any) -> "Parameter":
        kind, info = get_args(annotation)[:2]
        is_argument = isinstance(info, typer.models.ArgumentInfo)
        is_flag = kind is bool
        # Inside Annotated, typer takes the first declared name for a default.
        declared = (*([info.default] if isinstance(info.default, str) else []), *(info.param_decls or ()))
        dashed = name.replace("_", "-")
        names = declared or (f"--{dashed}", *([f"--no-{dashed}"] if is_flag else []))
        if is_argument:
            names = (info.metavar or name.upper(),)
        value = "" if is_flag or is_argument else info.metavar or _type_words(kind, info)
        return cls(names, value, _default(default), info.help or "", is_argument, info.hidden)

    def cells(self) -> tuple[str, str, str]:
        names = ", ".join(f"`{name}`" for name in self.names)
        return f"{names} {self.value}", self.default, self.help


def parameters(verb: Callable[..., None]) -> list[Parameter]:
    """What a verb takes, arguments first."""
    hints = get_type_hints(verb, include_extras=True)
    found = [
        Parameter.of(name, hints[name], parameter.default)
        for name, parameter in inspect.signature(verb).parameters.items()
    ]
    return sorted(found, key=lambda one: not one.is_argument)


def _section(
    path: str, verb: Callable[..., None], taken: Sequence[Parameter], shared: Sequence[Parameter]
) -> str:
    words = [path, *(one.names[0] for one in taken if one.is_argument)]
    lines = [f"## {' '.join(words)}\n\n{paragraphs(inspect.getdoc(verb))}"]
    if own := [one for one in taken if one not in shared]:
        lines += table(_OPTION, (one.cells() for one in own))
    lines.append("")
    if others := [f"`{one.names[0]}`" for one in taken if one in shared]:
        lines.append(f"Also {', '.join(others)}, as [above](#options-of-several-verbs).\n")
    return "\n".join(lines)


def _type_words(kind: Any, info: Any) -> str:
    """What may follow an option, in words."""
    kinds = {arg for arg in (kind, *get_args(kind)) if isinstance(arg, type)} - {NoneType}
    inner = {arg for given in get_args(kind) for arg in get_args(given)} | kinds
    words = next(word for one, word in _WORDS.items() if one in inner)
    limits = (("at least", info.min), ("at most", info.max))
    bounds = [f"{word} {number(limit)}" for word, limit in limits if limit is not None]
    is_list = list in {get_origin(arg) for arg in (kind, *get_args(kind))}
    return ", ".join([words, *bounds, *(["repeatable"] if is_list else [])])


_WORDS: Final = {Path: "path", int: "whole number", float: "number", str: "text"}


def _default(value: Any) -> str:
    if value is inspect.Parameter.empty:
        return "required"
    if isinstance(value, bool):
        return "on" if value else "off"
    return "" if value in (None, "") else f"`{value}`"
