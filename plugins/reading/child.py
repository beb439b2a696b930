"""The process that opens a foreign file: `python -m plugins.reading.child FILE OUT LIMITS`.

It has limits of memory and time, no network, and may write below OUT alone. It writes `content.json` and one `.npy`
file per array, which hold numbers and texts only, and ends. What a file could do to it ends with it.
"""

import contextlib
import ctypes
import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np

from plugins.reading.files import read_here
from plugins.reading.foreign import Content, Record

__all__ = ["decode", "encode", "main"]

CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
# Events of the interpreter (PEP 578) that reading a file needs no more once its code is loaded.
FORBIDDEN_EVENTS = (
    "socket.", "subprocess.", "os.system", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.kill", "os.remove",
    "os.rename", "os.chmod", "os.link", "os.symlink", "ctypes.", "exec", "compile", "import", "shutil.", "urllib.",
)  # fmt: skip


class _Unavailable(RuntimeError):
    """The reader tried something that it never needs."""


def main(file: Path, out: Path, memory_bytes: int, cpu_s: int, disk_bytes: int) -> None:
    """Read one file and write what it holds. Errors are written too, as `error`."""
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    resource.setrlimit(resource.RLIMIT_FSIZE, (disk_bytes, disk_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    isolation = _without_network()
    out.mkdir(exist_ok=True)
    np.save(out / "first.npy", np.zeros(1))  # loads what writing an array loads
    b"a".decode("cp437")  # the names in a zip archive
    sys.addaudithook(_refuse)
    try:
        form, content = read_here(file)
        written = {"form": form, "isolation": isolation, "values": encode(content, out)}
    except MemoryError:
        written = {"error": f"reading it needs more than the {memory_bytes >> 20} MiB allowed"}
    except OSError as error:
        written = {
            "error": f"it cannot be read, or an array of it exceeds the {disk_bytes >> 20} MiB allowed ({error})"
        }
    except Exception as error:  # noqa: BLE001 (foreign bytes raise any error; its words go to the caller)
        written = {"error": _words(error)}
    (out / "content.json").write_text(json.dumps(written))


def _without_network() -> str:
    """Leave the machine's network; the sentence says how."""
    with contextlib.suppress(OSError, AttributeError):
        if ctypes.CDLL(None, use_errno=True).unshare(CLONE_NEWUSER | CLONE_NEWNET) == 0:
            return "read in a process without network (own network namespace), with limits of memory and time"
    return (
        "read in a process with limits of memory and time, whose interpreter refuses sockets and programs (this system "
        "gives it no network namespace)"
    )


def _refuse(event: str, args: Any) -> None:
    """Events that reading never needs end the reading."""
    if event == "import" and args and args[0] in sys.modules:
        return
    if event.startswith(FORBIDDEN_EVENTS):
        raise _Unavailable(f"the reader has no use for {event}")


def _words(error: Exception) -> str:
    text = str(error) or type(error).__name__
    if isinstance(error, ValueError | RuntimeError) or type(error).__name__ == "ForbiddenGlobal":
        return text[:300]
    return f"it cannot be read ({type(error).__name__}: {text[:200]})"


def encode(content: Content, out: Path) -> list[list[Any]]:
    """List the values, where containers refer to others by their number; arrays are written as files."""
    numbers: dict[int, int] = {}
    values: list[Any] = []

    def number(value: Content) -> int:
        if id(value) not in numbers or not isinstance(value, dict | list | Record | np.ndarray):
            numbers[id(value)] = len(values)
            values.append(value)
        return numbers[id(value)]

    number(content)
    rows: list[list[Any]] = []
    while len(rows) < len(values):
        rows.append(_row(values[len(rows)], len(rows), number, out))
    return rows


def _row(value: Content, at: int, number: Any, out: Path) -> list[Any]:
    if isinstance(value, np.ndarray):
        np.save(out / f"{at}.npy", np.ascontiguousarray(value), allow_pickle=False)
        return ["a"]
    if isinstance(value, Record):
        return ["r", value.kind, number(value.args), number(value.state)]
    if isinstance(value, dict):
        return ["d", [[key, number(item)] for key, item in value.items()]]
    if isinstance(value, list):
        return ["l", [number(item) for item in value]]
    return ["f", repr(value)] if isinstance(value, float) else ["v", value]


def decode(rows: list[list[Any]], out: Path) -> Content:
    """Read back what `encode` gives. Arrays are mapped from their files, read-only."""
    values = [_empty(row, at, out) for at, row in enumerate(rows)]
    for row, value in zip(rows, values, strict=True):
        if row[0] == "d":
            value.update({key: values[at] for key, at in row[1]})
        elif row[0] == "l":
            value.extend(values[at] for at in row[1])
        elif row[0] == "r":
            value.args, value.state = values[row[2]], values[row[3]]
    return values[0]


def _empty(row: list[Any], at: int, out: Path) -> Any:
    match row[0]:
        case "a":
            return np.load(out / f"{at}.npy", mmap_mode="r", allow_pickle=False)
        case "r":
            return Record(row[1])
        case "d":
            return {}
        case "l":
            return []
        case "f":
            return float(row[1])
        case _:
            return row[1]


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:]))
    sys.stdout.flush()
    os._exit(0)
