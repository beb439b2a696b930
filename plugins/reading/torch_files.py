"""PyTorch's files without PyTorch: the zip archive of today, and the older stream of pickles.

Ref: torch/serialization.py. The archive has `data.pkl`, `byteorder` and one member per storage, none of them
compressed. The older file has four pickles (magic number, protocol, sizes of the platform, the object), the list of
storage keys, then every storage as its length, int64, and its raw elements.
"""

import io
import pickle
import zipfile
from functools import cache, partial
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plugins.reading.foreign import Record
from plugins.reading.inert import Inert, Unpickler
from plugins.reading.tensors import ArrayValue, DtypeValue, Storage, StorageType, TensorValue

__all__ = ["is_archive", "is_stream", "read_archive", "read_pickle", "read_stream"]

MAGIC = 0x1950A86A20F9469CFC6C
PROTOCOL = 1001
# The start of that magic number as a pickle of protocol 2 writes it.
STREAM_START = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."
MOST_VALUES = 2_000_000
"""Values that one file may hold, far above a complete pickled network (30,000)."""
MOST_MEMBERS = 20_000
MOST_PICKLE_BYTES = 256 << 20


def is_archive(start: bytes) -> bool:
    """Tell whether a file begins as a zip archive."""
    return start[:4] == b"PK\x03\x04"


def is_stream(start: bytes) -> bool:
    """Tell whether a file begins as PyTorch's older one."""
    return start.startswith(STREAM_START)


def read_archive(file: Any) -> Any:
    """The object of an archive. Errors: ValueError in words; any error on foreign bytes."""
    with zipfile.ZipFile(file) as archive:
        members = {member.filename: member for member in archive.infolist()}
        if len(members) > MOST_MEMBERS:
            raise ValueError(f"it has {len(members)} members, {MOST_MEMBERS} are allowed")
        if any("/code/__torch__" in name for name in members):
            raise ValueError(
                "it is a TorchScript archive; save model.state_dict() with torch.save, or export it to ONNX"
            )
        for member in members.values():
            _check_member(member)
        roots = [name.removesuffix("data.pkl") for name in members if PurePosixPath(name).name == "data.pkl"]
        if len(roots) != 1:
            raise ValueError("it is a zip archive without one data.pkl, so not of torch.save")
        root = roots[0]
        order = members.get(f"{root}byteorder")
        if order is not None and archive.read(order) != b"little":
            raise ValueError("it was written on a machine of the other byte order")
        if members[f"{root}data.pkl"].file_size > MOST_PICKLE_BYTES:
            raise ValueError(f"its data.pkl exceeds {MOST_PICKLE_BYTES >> 20} MiB")

        @cache
        def elements(key: str, kind: StorageType, count: int) -> NDArray[Any]:
            member = members.get(f"{root}data/{key}")
            if member is None or member.file_size != count * kind.itemsize:
                raise ValueError(f"its storage {key!r:.20} is missing or cut short")
            return kind.array(archive.read(member))

        def find_storage(pid: Any) -> Storage:
            kind, key, count = _check_reference(pid)
            return Storage(kind, count, partial(elements, key, kind, count))

        return _resolve(Unpickler(io.BytesIO(archive.read(f"{root}data.pkl")), find_storage, _NESTED).load())


def read_stream(file: Any) -> Any:
    """The object of an older file. Errors: as `read_archive`."""
    magic, protocol, platform = (Unpickler(file).load() for _ in range(3))
    if (magic, protocol) != (MAGIC, PROTOCOL) or not isinstance(platform, dict):
        raise ValueError("its magic number is not that of torch.save")
    arrays: dict[str, NDArray[Any]] = {}
    kinds: dict[str, tuple[StorageType, int]] = {}

    def find_storage(pid: Any) -> Storage:
        kind, key, count = _check_reference(pid)
        kinds[key] = (kind, count)
        return Storage(kind, count, lambda: arrays[key])

    value = Unpickler(file, find_storage, _NESTED).load()
    for key in Unpickler(file).load():
        kind, count = kinds[key]
        size = int.from_bytes(file.read(8), "little")
        data = file.read(count * kind.itemsize)
        if size != count or len(data) != count * kind.itemsize:
            raise ValueError(f"its storage {key!r:.20} is cut short")
        arrays[key] = kind.array(data)
    return _resolve(value)


def read_pickle(file: Any) -> Any:
    """The object of a plain pickle. Errors: as `read_archive`."""
    return _resolve(Unpickler(file, None, _NESTED).load())


def _read_nested(data: Any) -> Any:
    """A storage inside a plain pickle: PyTorch stores it there as a complete older file."""
    if not isinstance(data, bytes):
        raise ValueError("a tensor's bytes are missing")
    storage = read_archive(io.BytesIO(data)) if is_archive(data) else read_stream(io.BytesIO(data))
    if not isinstance(storage, Storage):
        raise ValueError("a tensor's bytes hold no storage")
    return storage


_NESTED = {"torch.storage._load_from_bytes": _read_nested}


def _resolve(value: Any) -> Any:
    """Storages read at once, because their file closes; everything else later."""
    if isinstance(value, Storage):
        array = np.array(value.read())
        return Storage(value.kind, value.count, lambda: array)
    return plain(value)


def _check_reference(pid: Any) -> tuple[StorageType, str, int]:
    if not isinstance(pid, tuple) or len(pid) not in (5, 6) or pid[0] != "storage":
        raise pickle.UnpicklingError("it refers to data that are no storage")
    _, kind, key, _, count = pid[:5]
    if not isinstance(kind, StorageType) or not isinstance(key, str) or type(count) is not int or count < 0:
        raise pickle.UnpicklingError("a storage is described wrongly")
    return kind, key, count


def _check_member(member: zipfile.ZipInfo) -> None:
    """Refuse a member that leaves the folder, or is compressed as torch.save never does. Errors: ValueError."""
    path = PurePosixPath(member.filename)
    if path.is_absolute() or ".." in path.parts or "\\" in member.filename:
        raise ValueError(f"its member '{member.filename[:60]}' leaves the archive's folder")
    if member.compress_type != zipfile.ZIP_STORED or member.flag_bits & 1:
        raise ValueError(
            f"its member '{member.filename[:60]}' is compressed or encrypted; torch.save stores plainly"
        )


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
