"""`NAME=VALUE` on the command line, the same for every option that takes it."""

import tomllib
from collections.abc import Sequence
from datetime import date, time

from edge.core.errors import ConfigError

__all__ = ["named_values"]


def named_values(option: str, given: Sequence[str]) -> dict[str, object]:
    """The values of texts such as `pace=0`, `rank=[1, 2]` or `faults=["drop@3"]`; the last value of a name counts.

    A value is a number, a boolean, a quoted text or a list in TOML syntax, otherwise plain text.
    Errors: ConfigError for a text without a name or without `=`.
    """
    values: dict[str, object] = {}
    for one in given:
        name, sign, text = one.partition("=")
        if not (name.strip().isidentifier() and sign):
            raise ConfigError(f"'{option} {one}' is not understood; write {option} name=value")
        values[name.strip()] = _value(text)
    return values


def _value(text: str) -> object:
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    # No option takes a date, and a serial number may look like one.
    return text if isinstance(value, date | time) else value
