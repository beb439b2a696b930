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
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Name:
    """A change of a name, which a loss of power may take back."""

    event: str
    path: Path
    new: Path
    """The new name of a file that is renamed; else its name."""
    old: bytes | None
    """What the new name held before; None for nothing."""
    losable: dict[int, list[bytes]]
    """The sectors of that which may be lost."""

    def undo(self, folder: Path, copy: Path) -> None:
        """Take it back in a copy of the folder."""
        path, new = (copy / one.relative_to(folder) for one in (self.path, self.new))
        if self.event == "os.rename":
            new.replace(path)
        elif self.event == "open":
            path.unlink(missing_ok=True)
        if self.old is not None:
            new.write_bytes(self.old)


class Unsynced:
    """What a loss of power may take from the files of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sectors: dict[str, dict[int, list[bytes]]] = {}
        """Of SQLite's files: what each sector that was written since the last sync held before, oldest first."""
        self.synced: dict[int, bytes] = {}
        """Of other files, by inode: the content at the last sync."""
        self.names: list[Name] = []
        """Changes of names that are not on the disk yet, in order."""
        self._sizes: dict[int, int] = {}  # by inode, at the last sync
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
            elif path.is_file():
                lost += _revert(twin, self.find_losable(path), share, rng)
        kept, share = rng.randint(0, len(self.names)), rng.choice((0.0, 0.5, 1.0))
        for name in reversed(self.names[kept:]):
            name.undo(self.folder, copy)
            if name.old is not None:
                _revert(copy / name.new.relative_to(self.folder), name.losable, share, rng)
        return lost + len(self.names) - kept

    def find_losable(self, path: Path) -> dict[int, list[bytes]]:
        """Find the sectors of a file that a loss of power may take, each with what it held before, oldest first."""
        if _is_database(path):
            return dict(self.sectors.get(str(path), {}))
        now, then = path.read_bytes(), self.synced.get(path.stat().st_ino, b"")
        return dict(_changed(then, now))

    def start_again(self) -> None:
        """The folder is another one, and all of it is on the disk."""
        self.sectors.clear()
        self.names.clear()
        files = [path for path in self.folder.rglob("*") if path.is_file() and not _is_database(path)]
        self.synced = {path.stat().st_ino: path.read_bytes() for path in files}
        self._sizes = {path.stat().st_ino: path.stat().st_size for path in files}

    def note_name(self, event: str, path: Path, new: Path | None = None) -> None:
        """Take a change of a name that comes now: a file is made, removed, or gets a new name."""
        new, is_there = new or path, path.exists()
        if is_there is (event == "open") or not path.is_relative_to(self.folder):
            return
        old = new.read_bytes() if new.is_file() else None
        self.names.append(Name(event, path, new, old, self.find_losable(new) if old is not None else {}))
        if old is not None:  # another file may get its inode
            inode = new.stat().st_ino
            self.synced.pop(inode, None)
            self._sizes.pop(inode, None)

    def keep_names(self, path: str) -> None:
        """Take that a file is synced: with its new length the file system writes all names that were changed before."""
        status = os.stat(path)
        if self._sizes.get(status.st_ino) != status.st_size:
            self._sizes[status.st_ino] = status.st_size
            self.names.clear()

    def note_sync(self, descriptor: int) -> None:
        """Take the content of a file that was synced."""
        path = os.readlink(f"/proc/self/fd/{descriptor}")
        if path.startswith(str(self.folder)) and os.path.isfile(path):
            with open(path, "rb") as file:
                self.synced[os.fstat(descriptor).st_ino] = file.read()
            self.keep_names(path)


def _is_database(path: Path) -> bool:
    return path.name.startswith("gelgate.db") and path.suffix != ".counts"


def _changed(then: bytes, now: bytes) -> Iterator[tuple[int, list[bytes]]]:
    for start in range(0, len(now), SECTOR):
        if then[start : start + SECTOR] != now[start : start + SECTOR]:
            yield start, [then[start : start + SECTOR]]


def _revert(path: Path, before: dict[int, list[bytes]], share: float, rng: random.Random) -> int:
    """Put back what sectors held at some time since the last sync. An end that was lost is zeros, or is not there."""
    drawn = {start: rng.random() for start in sorted(before)}
    drawn = {start: draw / share for start, draw in drawn.items() if draw < share}
    lost = {start: before[start][int(draw * len(before[start]))] for start, draw in drawn.items()}
    if lost and path.exists():
        size = end = path.stat().st_size
        with path.open("r+b") as file:
            for start, content in lost.items():
                file.seek(start)
                file.write(content.ljust(SECTOR, b"\0"))
            while end and not any(lost.get((end - 1) // SECTOR * SECTOR, b"there")):
                end = (end - 1) // SECTOR * SECTOR
            file.truncate(end if drawn[max(drawn)] < 0.5 else size)
    return len(lost)


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
            before = create_string_buffer(SECTOR)  # zeros where the file is shorter
            really_read(file, byref(before), SECTOR, sector)
            if before.raw not in (versions := sectors.setdefault(sector, [])):
                versions.append(before.raw)
        return int(really_write(file, data, size, start))

    def sync(file: int, flags: int) -> int:
        if found.at_sync is not None:
            found.at_sync()
        if found.fails is not None and found.fails("sync"):
            return IO_ERROR
        found.sectors.pop(names[file], None)
        found.keep_names(names[file])
        return int(really_sync(file, flags))

    def close(file: int) -> int:
        names.pop(file, None)
        return int(really_close(file))

    methods = Methods.from_buffer_copy(real)
    functions = TRANSFER(read), TRANSFER(write), SYNC(sync), CLOSE(close)
    methods.read, methods.write, methods.sync, methods.close = (cast(one, c_void_p) for one in functions)
    kept += functions
    return methods
