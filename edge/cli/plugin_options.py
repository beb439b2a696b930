"""`--option name=value` on the command line, as a plugin's options."""

import tomllib
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from edge.core.errors import ConfigError
from edge.table_faults import numbered, sentences

__all__ = ["plugin_options"]


def plugin_options(kind: str, name: str, model: type[BaseModel], given: Sequence[str]) -> Any:
    """The plugin's `Options` from texts such as `pace=0` or `faults=["drop@3"]`; a value is TOML, or else plain text.

    Errors: ConfigError with every fault.
    """
    table: dict[str, object] = {}
    for one in given:
        key, sign, value = one.partition("=")
        if not sign:
            raise ConfigError(f"--option is written name=value, found '{one}'")
        table[key.strip()] = _value(value)
    try:
        return model.model_validate(table)
    except ValidationError as error:
        faults = numbered(f"--option for the {kind} plugin '{name}'", sentences(model, error))
        raise ConfigError(f"{faults}\nit takes: {', '.join(model.model_fields)}") from error


def _value(text: str) -> object:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
