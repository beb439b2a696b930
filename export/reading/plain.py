"""From what an unpickler built to plain values: stand-ins become records, tensors become arrays."""

from typing import Any

import numpy as np

from export.reading.foreign import Record
from export.reading.inert import Inert
from export.reading.tensors import ArrayValue, DtypeValue, TensorValue

__all__ = ["MOST_VALUES", "plain"]

MOST_VALUES = 2_000_000
"""Values that one file may hold, far above a complete pickled network (30,000)."""


def plain(found: Any) -> Any:
    """The same as plain values, circles included. Errors: ValueError."""
    return _Converter().run(found)


class _Converter:
    """Converts without recursion, so that depth needs no stack; every object once, so circles end."""

    def __init__(self) -> None:
        self._done: dict[int, Any] = {}
        self._todo: list[tuple[Any, Any]] = []
        self._kept: list[Any] = []
        self._left = MOST_VALUES

    def run(self, found: Any) -> Any:
        result = self._value(found)
        while self._todo:
            source, target = self._todo.pop()
            self._fill(source, target)
        return result

    def _value(self, found: Any) -> Any:
        self._left -= 1
        if self._left < 0:
            raise ValueError(f"it holds more than {MOST_VALUES} values")
        if found is None or isinstance(found, bool | float | str) or type(found) is int:
            return found
        if id(found) in self._done:
            return self._done[id(found)]
        self._kept.append(found)  # an id is one object's as long as it lives
        made = self._made(found)
        self._done[id(found)] = made
        return made

    def _made(self, found: Any) -> Any:
        if isinstance(found, TensorValue | ArrayValue):
            array = found.array()
            return array if array.dtype.kind != "S" else array.astype(str).tolist()
        if isinstance(found, bytes | bytearray):
            return np.frombuffer(bytes(found), np.uint8)
        target: Any
        if isinstance(found, Inert):
            target = Record(type(found).kind)
        elif isinstance(found, dict):
            target = {}
        elif isinstance(found, list | tuple | set | frozenset):
            target = []
        else:
            return Record(f"a {'dtype' if isinstance(found, DtypeValue) else 'reference'}")
        self._todo.append((found, target))
        return target

    def _fill(self, source: Any, target: Any) -> None:
        if isinstance(target, Record):
            target.args = [self._value(one) for one in source.args]
            target.state = self._value(source.state if source.state is not None else source.items or None)
        elif isinstance(target, dict):
            for key, value in source.items():
                plain_key = key if isinstance(key, str | int | bool) else f"<{type(key).__name__}>"
                target[plain_key] = self._value(value)
        else:
            target.extend(self._value(one) for one in source)
