"""What a foreign file holds, as plain values: numbers, texts, lists, tables, arrays, and records of foreign classes.

A record is the name of a class with what the file keeps of an object; the class itself is never looked up.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32
from edge.core.errors import ConfigError

__all__ = ["Content", "Foreign", "Record", "attributes", "check_array", "describe", "float32"]

# Squares of larger numbers overflow float32, in which a gateway scores.
LARGEST = 1e15

Content = Any
"""None, bool, int, float, str, list, dict, ndarray or Record. Tuples and sets are lists."""


@dataclass
class Record:
    """An object of a foreign class."""

    kind: str
    """The class, `package.module.Class`."""
    args: list[Content] = field(default_factory=list)
    """The arguments of its constructor."""
    state: Content = None
    """What its pickle keeps, usually a table of attributes."""


@dataclass(frozen=True)
class Foreign:
    """A foreign file that was read."""

    path: Path
    """The file."""
    form: str
    """What kind of file it is, in words."""
    content: Content
    """What it holds."""
    isolation: str = ""
    """How the reader was kept from the rest of the machine, one sentence."""

    def table(self) -> Mapping[Any, Content]:
        """Give the content as a table, empty where it is not one."""
        return self.content if isinstance(self.content, dict) else {}

    def array(self, name: str, *shape: int | None) -> NDArray[Any]:
        """A numeric array of the table. shape: expected sizes, None for any; no shape at all accepts every one.

        Errors: ConfigError that names the file, the field, what was found and what was expected.
        """
        return check_array(self.path, name, self.table().get(name), *shape)


def check_array(path: Path, name: str, value: Content, *shape: int | None) -> NDArray[Any]:
    """Give `value` as an array of real, finite numbers of that shape. Errors: as `Foreign.array`."""
    if isinstance(value, list) and value and all(_is_number(item) for item in value):
        value = np.array(value)
    wanted = f"numbers of shape ({', '.join('any' if n is None else str(n) for n in shape)})"
    if not isinstance(value, np.ndarray):
        raise ConfigError(f"{path}: '{name}' is {describe(value)}, {wanted} were expected")
    fits = value.ndim == len(shape) and all(
        n is None or n == m for n, m in zip(shape, value.shape, strict=False)
    )
    if value.dtype.kind not in "fiub" or (shape and not fits):
        raise ConfigError(f"{path}: '{name}' is {describe(value)}, {wanted} were expected")
    if value.size == 0:
        raise ConfigError(
            f"{path}: '{name}' is empty; the model was saved before it was fitted, save it after the fit"
        )
    # NaN fails the comparison too.
    if value.dtype.kind == "f" and not bool(np.abs(value).max() <= LARGEST):
        raise ConfigError(
            f"{path}: '{name}' holds values that are not finite or beyond {LARGEST:g}; fit the model again"
        )
    return value


def _is_number(value: Content) -> bool:
    return isinstance(value, int | float) or (isinstance(value, np.ndarray) and value.ndim == 0)


def float32(array: NDArray[Any]) -> F32:
    """Convert to single precision, contiguous; numbers too small for it become 0."""
    with np.errstate(under="ignore"):
        return np.ascontiguousarray(array, np.float32)


def attributes(value: Content) -> Mapping[Any, Content]:
    """The attributes of a record, empty where it has none."""
    state = value.state if isinstance(value, Record) else None
    if isinstance(state, list) and state and isinstance(state[0], dict):
        state = state[0]
    return state if isinstance(state, dict) else {}


def describe(value: Content) -> str:
    """Say in a few words what a value is, for messages."""
    if isinstance(value, np.ndarray):
        return f"an array {value.dtype} {value.shape}"
    if isinstance(value, dict):
        first = ", ".join(str(name)[:40] for name in islice(value, 5))
        return f"a table of {first}" if value else "an empty table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, Record):
        return f"a {value.kind}"
    return "missing" if value is None else f"{type(value).__name__} {value!r:.40}"
