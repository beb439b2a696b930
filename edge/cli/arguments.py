"""Reads what a command line gives: a verb's options as one value, `NAME=VALUE`, and a plugin's options."""

import inspect
import tomllib
from collections.abc import Callable, Collection, Sequence
from dataclasses import MISSING, field, fields
from datetime import date, time
from typing import Annotated, Any, TypeVar, get_type_hints

import typer
from pydantic import BaseModel, ValidationError

from edge.core.errors import ConfigError
from edge.validation_messages import numbered, sentences

__all__ = ["add_argument", "add_option", "flatten", "parse_values", "plugin_options"]

OptionsT = TypeVar("OptionsT", bound=BaseModel)


def add_option(default: Any, text: str, *names: str, **more: Any) -> Any:
    """Make a field of a verb's options, with its help. default: `...` where it is required. names: on the command line,
    where they are not the field's own. more: as `typer.Option` takes them."""
    return _field(default, typer.Option(*names, help=text, **more))


def add_argument(default: Any, text: str, **more: Any) -> Any:
    """Make a field that is an argument; all as for `add_option`."""
    return _field(default, typer.Argument(help=text, **more))


def _field(default: Any, info: Any) -> Any:
    return field(default=MISSING if default is ... else default, metadata={"typer": info})


def flatten(verb: Callable[[Any], None], without: Collection[str] = ()) -> Callable[..., None]:
    """Make the verb that typer reads from one that takes its options as one dataclass.

    Each field is of `add_option` or `add_argument`, or `Annotated` with one, and becomes a parameter; the order is that
    of the help. without: fields with a default that this verb has no option for.
    """
    ((_, model),) = ((name, hint) for name, hint in get_type_hints(verb).items() if name != "return")
    hints = get_type_hints(model, include_extras=True)
    for option in fields(model):
        if "typer" in option.metadata:
            hints[option.name] = Annotated[hints[option.name], option.metadata["typer"]]

    def call(**given: Any) -> None:
        verb(model(**given))

    parameters = [
        inspect.Parameter(
            one.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if one.default is MISSING else one.default,
            annotation=hints[one.name],
        )
        for one in fields(model)
        if one.name not in without
    ]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what inspect and typer read
    call.__annotations__ = hints
    call.__doc__, call.__name__ = verb.__doc__, verb.__name__
    return call


def parse_values(option: str, given: Sequence[str]) -> dict[str, object]:
    """The values of texts such as `pace=0`, `rank=[1, 2]` or `faults=["drop@3"]`; the last value of a name counts.

    A value is a number, a boolean, a quoted text or a list in TOML syntax, otherwise plain text.
    Errors: ConfigError for a text without a name or without `=`.
    """
    values: dict[str, object] = {}
    for pair in given:
        name, sign, text = pair.partition("=")
        if not (name.strip().isidentifier() and sign):
            raise ConfigError(f"'{option} {pair}' is not understood; write {option} name=value")
        values[name.strip()] = _value(text)
    return values


def _value(text: str) -> object:
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    # No option takes a date, and a serial number may look like one.
    return text if isinstance(value, date | time) else value


def plugin_options(kind: str, name: str, model: type[OptionsT], given: Sequence[str]) -> OptionsT:
    """Read a plugin's `Options` from texts such as `pace=0`. Errors: ConfigError with every fault."""
    try:
        return model.model_validate(parse_values("--option", given))
    except ValidationError as error:
        faults = numbered(f"--option for the {kind} plugin '{name}'", sentences(model, error))
        raise ConfigError(f"{faults}\nit takes: {', '.join(model.model_fields)}") from error
