"""Arrays and tensors of pickles, built from their bytes with every size checked.

Ref: torch/_utils.py and torch/storage.py (a tensor is a view of a storage: offset, sizes and strides in elements),
numpy/core/src/multiarray/methods.c (an array's state: version, shape, dtype, Fortran order, bytes).
"""

import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["DTYPES", "ArrayValue", "DtypeValue", "Storage", "StorageType", "TensorValue", "widen"]

# torch's storage classes and how their elements are stored; bfloat16 is the upper half of a float32.
DTYPES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "BFloat16Storage": "bfloat16",
    "LongStorage": "<i8", "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "|i1", "ByteStorage": "|u1",
    "BoolStorage": "|b1",
}  # fmt: skip
KINDS = frozenset("biufS")
MOST_AXES = 8


class StorageType:
    """A class of storages by its name."""

    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        self.name = name

    def __setstate__(self, state: object) -> None:
        raise pickle.UnpicklingError("a pickle tries to change a class")

    @property
    def itemsize(self) -> int:
        return np.dtype(self._stored).itemsize

    @property
    def _stored(self) -> str:
        return "<u2" if DTYPES[self.name] == "bfloat16" else DTYPES[self.name]

    def array(self, data: bytes) -> NDArray[Any]:
        """The elements of a storage's bytes."""
        return np.frombuffer(data, self._stored)


class Storage:
    """One block of elements. read: gives them, when the file has them."""

    __slots__ = ("count", "kind", "read")

    def __init__(self, kind: StorageType, count: int, read: Callable[[], NDArray[Any]]) -> None:
        self.kind, self.count, self.read = kind, count, read

    def __setstate__(self, state: object) -> None:
        raise pickle.UnpicklingError("a pickle tries to change a storage")


class TensorValue:
    """A view of a storage, not read yet: offset, sizes and strides in elements."""

    __slots__ = ("_offset", "_size", "_storage", "_stride")

    def __init__(self, storage: Any, offset: Any, size: Any, stride: Any, *_: Any) -> None:
        self._storage, self._offset, self._size, self._stride = storage, offset, tuple(size), tuple(stride)

    def __setstate__(self, state: object) -> None:
        """Attributes of a tensor, which carry no numbers."""

    def array(self) -> NDArray[Any]:
        """The numbers, contiguous; bfloat16 and float16 as float32. Errors: ValueError."""
        storage = self._storage
        numbers = (self._offset, *self._size, *self._stride)
        if not isinstance(storage, Storage) or any(type(n) is not int or n < 0 for n in numbers):
            raise ValueError("a tensor has no storage, or negative sizes")
        if len(self._size) != len(self._stride) or len(self._size) > MOST_AXES:
            raise ValueError(f"a tensor has sizes {self._size} and strides {self._stride}")
        flat = storage.read()[self._offset :]
        count = math.prod(self._size)
        end = sum(step * (n - 1) for step, n in zip(self._stride, self._size, strict=True)) + 1
        if count and (end > len(flat) or count > storage.count):
            raise ValueError(f"a tensor of sizes {self._size} exceeds its storage of {storage.count}")
        steps = [step * flat.itemsize for step in self._stride]
        view = np.lib.stride_tricks.as_strided(flat[:count] if not count else flat, self._size, steps)
        return widen(np.ascontiguousarray(view).reshape(self._size), DTYPES[storage.kind.name] == "bfloat16")


def widen(array: NDArray[Any], is_bfloat16: bool = False) -> NDArray[Any]:
    """Half precision as float32, other numbers unchanged."""
    if is_bfloat16:
        return (array.astype(np.uint32) << 16).view(np.float32)
    return array.astype(np.float32) if array.dtype == np.float16 else array


class DtypeValue:
    """A NumPy dtype by its text, such as `f4`; its byte order comes with its state."""

    __slots__ = ("_order", "_text")

    def __init__(self, text: Any = "", *_: Any) -> None:
        self._text, self._order = text, "|"

    def __setstate__(self, state: Any) -> None:
        self._order = state[1]

    def dtype(self) -> np.dtype[Any]:
        """The dtype. Errors: ValueError for anything but plain numbers, or short texts of one byte per letter."""
        if not isinstance(self._text, str) or self._order not in ("<", ">", "|", "="):
            raise ValueError("an array's dtype is not plain")
        try:
            dtype = np.dtype(self._text).newbyteorder(self._order)  # type: ignore[arg-type]  # one of the four
        except TypeError as error:
            raise ValueError(f"no dtype is named {self._text!r:.20}") from error
        if dtype.kind not in KINDS or dtype.fields is not None or dtype.itemsize > 64:
            raise ValueError(f"an array of dtype {self._text!r:.20} holds no plain numbers")
        return dtype


class ArrayValue:
    """A NumPy array, not read yet."""

    __slots__ = ("_state", "axes")

    def __init__(self, *_: Any) -> None:
        self._state: Any = None
        self.axes: Any = None
        """Which axis of the state is the first, the second and so on, as in `transpose`; None: as they are."""

    def __setstate__(self, state: Any) -> None:
        self._state = state

    def array(self) -> NDArray[Any]:
        """The numbers. Errors: ValueError."""
        if not isinstance(self._state, tuple) or len(self._state) != 5:
            raise ValueError("an array has no state")
        _, shape, dtype, is_fortran, data = self._state
        if isinstance(data, str):
            data = data.encode("latin1")
        if not isinstance(dtype, DtypeValue) or not isinstance(data, bytes | bytearray):
            raise ValueError("an array holds objects, not numbers")
        plain = isinstance(shape, tuple | list) and all(type(n) is int and n >= 0 for n in shape)
        if not plain or len(shape) > MOST_AXES or math.prod(shape) * dtype.dtype().itemsize != len(data):
            raise ValueError(f"an array of shape {shape!r:.60} does not have its {len(data)} bytes")
        straight = [*range(len(shape))]
        axes = straight if self.axes is None else self.axes
        if sorted(axes) != straight:
            raise ValueError(f"an array of {len(shape)} axes has them in the order {axes!r:.60}")
        flat = np.frombuffer(data, dtype.dtype())
        native = flat.astype(flat.dtype.newbyteorder("="), copy=False)
        return widen(native.reshape(shape, order="F" if is_fortran else "C").transpose(axes))
