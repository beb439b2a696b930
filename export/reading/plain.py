"""From what an unpickler built to plain values: stand-ins become records, tensors become arrays."""

from typing import Any

import numpy as np

from export.reading.foreign import Record
from export.reading.inert import Inert
from export.reading.tensors import ArrayValue, DtypeValue, TensorValue

__all__ = ["MOST_VALUES", "plain"]

MOST_VALUES = 2_000_000
"""Values that one file may hold, far above a complete pickled network (30,000)."""


def plain(value: Any) -> Any:
    """Convert an object to plain values, circles included. Errors: ValueError."""
    return _Converter().run(value)


class _Converter:
    """Converts without recursion, so that depth needs no stack; every object once, so circles end."""

    def __init__(self) -> None:
        self._done: dict[int, Any] = {}
        self._todo: list[tuple[Any, Any]] = []
        self._kept: list[Any] = []
        self._left = MOST_VALUES

    def run(self, value: Any) -> Any:
        result = self._value(value)
        while self._todo:
            source, target = self._todo.pop()
            self._fill(source, target)
        return result

    def _value(self, value: Any) -> Any:
        self._left -= 1
        if self._left < 0:
            raise ValueError(f"it holds more than {MOST_VALUES} values")
        if value is None or isinstance(value, bool | float | str) or type(value) is int:
            return value
        if id(value) in self._done:
            return self._done[id(value)]
        self._kept.append(value)  # an id is one object's as long as it lives
        made = self._make(value)
        self._done[id(value)] = made
        return made

    def _make(self, value: Any) -> Any:
        if isinstance(value, TensorValue | ArrayValue):
            array = value.array()
            return array if array.dtype.kind != "S" else array.astype(str).tolist()
        if isinstance(value, bytes | bytearray):
            return np.frombuffer(bytes(value), np.uint8)
        target: Any
        if isinstance(value, Inert):
            target = Record(type(value).kind)
        elif isinstance(value, dict):
            target = {}
        elif isinstance(value, list | tuple | set | frozenset):
            target = []
        else:
            return Record(f"a {'dtype' if isinstance(value, DtypeValue) else 'reference'}")
        self._todo.append((value, target))
        return target

    def _fill(self, source: Any, target: Any) -> None:
        if isinstance(target, Record):
            target.args = [self._value(item) for item in source.args]
            target.state = self._value(source.state if source.state is not None else source.items or None)
        elif isinstance(target, dict):
            for key, value in source.items():
                plain_key = key if isinstance(key, str | int | bool) else f"<{type(key).__name__}>"
                target[plain_key] = self._value(value)
        else:
            target.extend(self._value(item) for item in source)
