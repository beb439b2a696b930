"""The loss of power: what was written and not synced is lost, or torn at 512 bytes, in any subset.

SQLite's own default file system is listened to: in the library that the program uses, the function that opens a file is
exchanged by one that also exchanges write, sync and close. For other files the synced content is known by `os.fsync`.
Ref: https://www.sqlite.org/c3ref/vfs.html and https://www.sqlite.org/c3ref/io_methods.html.
"""

import ctypes
import os
import random
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import (
    CFUNCTYPE,
    POINTER,
    Structure,
    byref,
    c_char_p,
    c_int,
    c_int64,
    c_void_p,
    cast,
    create_string_buffer,
)
from pathlib import Path
from typing import Any

SECTOR = 512
IO_ERROR, FULL = 10, 13
OPEN = CFUNCTYPE(c_int, c_void_p, c_void_p, c_void_p, c_int, c_void_p)
TRANSFER = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int, c_int64)
SYNC = CFUNCTYPE(c_int, c_void_p, c_int)
CLOSE = CFUNCTYPE(c_int, c_void_p)
SLEEP = CFUNCTYPE(c_int, c_void_p, c_int)


class Vfs(Structure):
    _fields_ = (
        ("head", c_int * 3),
        ("next", c_void_p),
        ("name", c_char_p),
        ("data", c_void_p),
        ("open", c_void_p),
        ("others", c_void_p * 8),
        ("sleep", c_void_p),
    )


class Methods(Structure):
    """sqlite3_io_methods of version 3."""

    _fields_ = (
        *((name, c_void_p) for name in ("version", "close", "read", "write", "truncate", "sync", "size")),
        ("rest", c_void_p * 12),
    )


class Unsynced:
    """What a loss of power may take from the files of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sectors: dict[str, dict[int, bytes]] = {}
        """Of SQLite's files: the bytes before each sector that was written since the last sync."""
        self.synced: dict[int, bytes] = {}
        """Of other files, by inode: the content at the last sync."""
        self.at_sync: Callable[[], object] | None = None
        """Called at each sync: it takes its time."""
        self.at_sleep: Callable[[float], object] = time.sleep
        """What SQLite does between two attempts to get a lock."""
        self.fails: Callable[[str], bool] | None = None
        """Tells whether a `read`, `write` or `sync` of the database fails."""
        self.room: int | None = None
        """So many bytes of the database are still taken; None: there is room."""

    def lose(self, copy: Path, rng: random.Random) -> int:
        """Take from a copy of the folder what a loss of power takes; returns the number of sectors."""
        lost = 0
        for path in sorted(self.folder.rglob("*")):
            twin = copy / path.relative_to(self.folder)
            share = rng.choice((0.0, 0.5, 1.0))
            if path.name.endswith("-shm"):
                twin.unlink(missing_ok=True)
            elif path.is_file() and path.name.startswith("gelgate.db") and path.suffix != ".counts":
                lost += _revert(twin, self.sectors.get(str(path), {}), share, rng)
            elif path.is_file():
                now, then = path.read_bytes(), self.synced.get(path.stat().st_ino, b"")
                lost += _revert(twin, dict(_changed(then, now)), share, rng)
        return lost

    def start_again(self) -> None:
        """The folder is another one, and all of it is on the disk."""
        self.sectors.clear()
        files = (path for path in self.folder.rglob("*") if path.is_file())
        self.synced = {path.stat().st_ino: path.read_bytes() for path in files}

    def note_sync(self, descriptor: int) -> None:
        """Take the content of a file that was synced."""
        path = os.readlink(f"/proc/self/fd/{descriptor}")
        if path.startswith(str(self.folder)) and os.path.isfile(path):
            with open(path, "rb") as file:
                self.synced[os.fstat(descriptor).st_ino] = file.read()


def _changed(then: bytes, now: bytes) -> Iterator[tuple[int, bytes]]:
    for start in range(0, len(now), SECTOR):
        if then[start : start + SECTOR] != now[start : start + SECTOR]:
            yield start, then[start : start + SECTOR]


def _revert(path: Path, before: dict[int, bytes], share: float, rng: random.Random) -> int:
    chosen = [start for start in sorted(before) if rng.random() < share]
    if chosen and path.exists():
        with path.open("r+b") as file:
            for start in chosen:
                file.seek(start)
                file.write(before[start].ljust(SECTOR, b"\0"))
    return len(chosen)


def find_library() -> str:
    """Return the SQLite that this Python has loaded. Errors: RuntimeError where it is built in."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    found = next(
        (words[5] for line in lines if "libsqlite3" in line and len(words := line.split()) > 5), None
    )
    if found is None:
        raise RuntimeError(
            f"SQLite {sqlite3.sqlite_version} is built into this Python, so nobody can listen to its writes; use a "
            "Python that loads libsqlite3"
        )
    return found


@contextmanager
def listening(folder: Path) -> Iterator[Unsynced]:
    """Listen to all that is written in a folder."""
    found, library = Unsynced(folder), ctypes.CDLL(find_library())
    library.sqlite3_vfs_find.restype = POINTER(Vfs)
    vfs = library.sqlite3_vfs_find(None).contents
    real, kept = (vfs.open, vfs.sleep), _exchange(found, vfs)
    syncs = os.fsync, os.fdatasync
    os.fsync, os.fdatasync = (_noted(found, sync) for sync in syncs)
    try:
        yield found
    finally:
        vfs.open, vfs.sleep = real
        os.fsync, os.fdatasync = syncs
        _KEPT.append(kept)


_KEPT: list[Any] = []
"""Functions that SQLite may still call: a connection that is not closed has them."""


def _noted(found: Unsynced, sync: Callable[[int], None]) -> Callable[[int], None]:
    def synced(descriptor: int) -> None:
        if found.at_sync is not None:
            found.at_sync()
        sync(descriptor)
        found.note_sync(descriptor)

    return synced


def _exchange(found: Unsynced, vfs: Vfs) -> list[Any]:
    """Exchange the function that opens a file; returns what must be kept alive."""
    really_open, names = OPEN(vfs.open), dict[int, str]()
    tables: dict[int, Methods] = {}
    kept: list[Any] = []

    def open_file(this: int, name: int | None, file: int, flags: int, out: int) -> int:
        path = ctypes.string_at(name).decode() if name else ""
        if not os.path.exists(path):  # an earlier file of this name was removed
            found.sectors.pop(path, None)
        code = int(really_open(this, name, file, flags, out))
        place = cast(file, POINTER(c_void_p))
        if code == 0 and place[0] and path.startswith(str(found.folder)):
            names[file] = path
            if place[0] not in tables:
                tables[place[0]] = _listening_methods(found, names, place[0], kept)
            place[0] = ctypes.addressof(tables[place[0]])
        return code

    def sleep(this: int, microseconds: int) -> int:
        found.at_sleep(microseconds / 1e6)
        return microseconds

    opened, slept = OPEN(open_file), SLEEP(sleep)
    kept += [opened, slept, tables]
    vfs.open, vfs.sleep = cast(opened, c_void_p), cast(slept, c_void_p)
    return kept


def _listening_methods(found: Unsynced, names: dict[int, str], address: int, kept: list[Any]) -> Methods:
    """Make the methods of an open file that note what is written, and what is synced."""
    real = Methods.from_address(address)
    really_read, really_write = TRANSFER(real.read), TRANSFER(real.write)
    really_sync, really_close = SYNC(real.sync), CLOSE(real.close)

    def read(file: int, data: int, size: int, start: int) -> int:
        if found.fails is not None and found.fails("read"):
            return IO_ERROR
        return int(really_read(file, data, size, start))

    def write(file: int, data: int, size: int, start: int) -> int:
        if found.fails is not None and found.fails("write"):
            return IO_ERROR
        if found.room is not None:
            found.room -= size
            if found.room < 0:
                return FULL
        sectors = found.sectors.setdefault(names[file], {})
        for sector in range(start // SECTOR * SECTOR, start + size, SECTOR):
            if sector not in sectors:
                before = create_string_buffer(SECTOR)  # zeros where the file is shorter
                really_read(file, byref(before), SECTOR, sector)
                sectors[sector] = before.raw
        return int(really_write(file, data, size, start))

    def sync(file: int, flags: int) -> int:
        if found.at_sync is not None:
            found.at_sync()
        if found.fails is not None and found.fails("sync"):
            return IO_ERROR
        found.sectors.pop(names[file], None)
        return int(really_sync(file, flags))

    def close(file: int) -> int:
        names.pop(file, None)
        return int(really_close(file))

    methods = Methods.from_buffer_copy(real)
    functions = TRANSFER(read), TRANSFER(write), SYNC(sync), CLOSE(close)
    methods.read, methods.write, methods.sync, methods.close = (cast(one, c_void_p) for one in functions)
    kept += functions
    return methods
