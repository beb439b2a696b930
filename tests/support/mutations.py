"""Files that are wrong in one place: bytes flipped, cut or repeated, values of another kind, and calls of a canary."""

import contextlib
import io
import pickle
import random
import resource
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from plugins.reading.foreign import Record
from plugins.reading.isolated import BASE_BYTES

_VALUES: list[Any] = [
    None, True, -1, 0, 2**40, float("nan"), "", "text", [], {}, [[]], np.zeros(0), np.zeros((2, 2, 2, 2)),
    np.full(3, np.inf), np.array(7), Record("torch.nn.modules.x.Y", [1], {"a": 1}),
]  # fmt: skip


@contextlib.contextmanager
def as_little_memory_as_the_reader() -> Iterator[None]:
    """What the reader's process may take, on top of what this one has: one byte of a pickle can ask for gigabytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + BASE_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def changed_bytes(data: bytes, rng: random.Random) -> bytes:
    """A file with some bytes changed; in an archive those of its pickle, packed again so that its sum is right."""
    if data[:4] != b"PK\x03\x04" or rng.random() < 0.2:
        return _scrambled(data, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as new:
        for member in old.infolist():
            content = old.read(member)
            name = member.filename
            if name.endswith("data.pkl"):
                content = _scrambled(content, rng)
            elif rng.random() < 0.02:
                name = rng.choice(["../" + name, "/" + name, name + "x", name])
                content = content[: rng.randrange(len(content) + 1)]
            new.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def _scrambled(data: bytes, rng: random.Random) -> bytes:
    found = bytearray(data)
    # The beginning of a file decides how it is read.
    reach = len(found) if rng.random() < 0.5 else min(len(found), 2000)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        at = rng.randrange(reach)
        match rng.randrange(4):
            case 0:
                found[at] = rng.randrange(256)
            case 1:
                found[at] ^= 1 << rng.randrange(8)
            case 2:
                del found[at : at + rng.randrange(1, 9)]
            case _:
                found[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(1, 5)))
        reach = max(1, min(reach, len(found)))
    return bytes(found)


def changed_value(content: Any, rng: random.Random, depth: int = 0) -> Any:
    """The same content with one value in it, at any depth, of another kind, size or sign, or missing."""
    if isinstance(content, dict) and content and (depth == 0 or rng.random() < 0.8):
        key = rng.choice(list(content))
        changed = dict(content)
        if rng.random() < 0.15:
            del changed[key]
        else:
            changed[key] = changed_value(content[key], rng, depth + 1)
        return changed
    if isinstance(content, list) and content and rng.random() < 0.7:
        at = rng.randrange(len(content))
        return [*content[:at], changed_value(content[at], rng, depth + 1), *content[at + 1 :]]
    if isinstance(content, Record) and rng.random() < 0.8:
        return Record(content.kind, content.args, changed_value(content.state, rng, depth + 1))
    if isinstance(content, np.ndarray) and content.size and rng.random() < 0.7:
        return _changed_array(content, rng)
    return rng.choice(_VALUES)


def _changed_array(array: Any, rng: random.Random) -> Any:
    match rng.randrange(6):
        case 0:
            return array[1:] if array.ndim else array
        case 1:
            return array.reshape(-1)
        case 2:
            return -array.astype(np.float64)
        case 3:
            return np.where(np.arange(array.size).reshape(array.shape) == 0, np.nan, array.astype(np.float64))
        case 4:
            return array.astype(np.float64) * 1e300
        case _:
            return array.T


class _Call:
    def __init__(self, function: Any, *args: Any) -> None:
        self.reduced = function, args

    def __reduce__(self) -> Any:
        return self.reduced


def with_canary(content: Any, canary: Path, rng: random.Random) -> bytes:
    """A pickle of the content that would also make the file `canary`, if anything in it were run."""
    import os
    import subprocess

    text = f"open({str(canary)!r}, 'w').close()"
    call = rng.choice(
        [_Call(os.system, f"touch {canary}"), _Call(exec, text), _Call(eval, text), _Call(open, str(canary), "w"),
         _Call(subprocess.check_call, ["touch", str(canary)]), _Call(os.mkdir, str(canary)),
         _Call(Path.touch, canary)]
    )  # fmt: skip
    return pickle.dumps(
        [call, content] if rng.random() < 0.5 else {"content": content, "x": call}, rng.randrange(2, 6)
    )
