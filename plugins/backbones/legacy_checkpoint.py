"""Reads PyTorch's old file of weights (before version 1.6, no zip archive) without PyTorch.

Ref: torch/serialization.py, `_legacy_load`: four pickles (magic number, protocol, sizes of the platform, the weights),
the list of storage keys, then every storage as its length, int64, and its raw elements.

A pickle can run any code of its author. Here only the five names that a file of weights needs can be looked up.
"""

import pickle
from collections import OrderedDict
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["read_legacy_checkpoint"]

MAGIC = 0x1950A86A20F9469CFC6C
PROTOCOL = 1001
_DTYPES = {"FloatStorage": "<f4", "LongStorage": "<i8"}


class _Storage:
    """One block of elements, filled after the pickles are read."""

    def __init__(self, dtype: str, count: int) -> None:
        self.array: NDArray[Any] = np.empty(count, dtype)


class _Tensor:
    """A view of a storage: offset and strides in elements."""

    def __init__(
        self, storage: _Storage, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
    ):
        self._storage, self._offset, self._size, self._stride = storage, offset, size, stride

    def read(self) -> NDArray[Any]:
        flat = self._storage.array[self._offset :]
        end = sum(step * (count - 1) for step, count in zip(self._stride, self._size, strict=True))
        if end >= len(flat):
            raise ValueError("a tensor exceeds its storage")
        steps = [step * flat.itemsize for step in self._stride]
        return np.lib.stride_tricks.as_strided(flat, self._size, steps).copy()


class _Weights(pickle.Unpickler):
    """The unpickler for the weights alone."""

    def __init__(self, file: BytesIO) -> None:
        super().__init__(file)
        self.storages: dict[str, _Storage] = {}

    def find_class(self, module: str, name: str) -> Any:
        known = {
            ("collections", "OrderedDict"): OrderedDict,
            ("torch._utils", "_rebuild_tensor_v2"): _Tensor,
            **{("torch", storage): storage for storage in _DTYPES},
        }
        if (module, name) not in known:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which no file of weights needs")
        return known[module, name]

    def persistent_load(self, pid: Any) -> _Storage:
        kind, storage, key, _place, count, _view = pid
        if kind != "storage":
            raise pickle.UnpicklingError(f"it has an entry of kind {kind!r}")
        return self.storages.setdefault(key, _Storage(_DTYPES[storage], count))


def read_legacy_checkpoint(data: bytes) -> dict[str, NDArray[Any]]:
    """The weights by name. Errors: ValueError for anything else than such a file."""
    file = BytesIO(data)
    try:
        magic, protocol, _platform = (_Weights(file).load() for _ in range(3))
        if (magic, protocol) != (MAGIC, PROTOCOL):
            raise ValueError("its magic number is another one")
        reader = _Weights(file)
        state = reader.load()
        for key in _Weights(file).load():
            _fill(reader.storages[key].array, file)
        return {name: value.read() for name, value in state.items() if isinstance(value, _Tensor)}
    except ValueError:
        raise
    except Exception as error:  # on foreign bytes unpickling raises any error
        raise ValueError(f"{type(error).__name__}: {error}") from error


def _fill(array: NDArray[Any], file: BytesIO) -> None:
    count = int.from_bytes(file.read(8), "little")
    data = file.read(array.nbytes)
    if count != len(array) or len(data) != array.nbytes:
        raise ValueError("a storage is cut off")
    array[:] = np.frombuffer(data, array.dtype)
