"""The disk of a station: each write to it is a point at which the process can be killed.

The interpreter's audit events give every connection to SQLite and every file operation; nothing of the program is
replaced. At the chosen point the folder is copied.
"""

import os
import shutil
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from simulation.locks import Locker
from simulation.power import Unsynced

TRANSACTION = ("BEGIN", "COMMIT", "ROLLBACK")
WRITES = {"os.rename", "os.remove", "os.mkdir", "os.link", "os.truncate"}
ROOM_BYTES = 10**11
"""What the disk says that it has free."""


class Disk:
    """The folder of a station, and the writes to it. `kill_in` counts down; at 0 the folder is copied."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.points = 0
        self.kill_in: int | None = None
        self.unsynced: Unsynced | None = None
        self.lost: Callable[[Unsynced, Path], None] | None = None
        """Takes from the copy what a loss of power takes; None where only the process is killed."""
        self.is_full = False
        self.full_since_ns = 0
        self.free_bytes = ROOM_BYTES
        self.locker = Locker(folder / "gelgate.db")
        self.copy: Path | None = None
        self.killed_at = ""
        self._new: list[sqlite3.Connection] = []
        self._is_copying = False

    @property
    def is_dead(self) -> bool:
        """True from the point on at which the process was killed."""
        return self.copy is not None

    def hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Take an audit event of the interpreter."""
        if self._is_copying or event.startswith("ctypes"):  # SQLite is in the middle of a call
            return
        self.attach()
        if event == "sqlite3.connect/handle":
            self._new.append(arguments[0])
        elif event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR):
            self._write_file(event, arguments[0])
        elif event in WRITES:
            self._write_file(event, *arguments[: 2 if event == "os.rename" else 1])

    def fill(self, room: int | None) -> None:
        """Leave so many bytes for SQLite, and none for another file; None: room again. What leaves some is a quota, of
        which the disk does not tell."""
        assert self.unsynced is not None
        self.is_full, self.unsynced.room = room is not None, room
        self.free_bytes = 0 if room == 0 else ROOM_BYTES

    @contextmanager
    def sparing(self) -> Iterator[None]:
        """Let nothing fail that an auditor reads."""
        unsynced = self.unsynced or Unsynced(self.folder)
        kept, unsynced.fails = unsynced.fails, None
        try:
            yield
        finally:
            unsynced.fails = kept

    def read(self, query: str, *values: object) -> list[Any]:
        """Read the database for an auditor: no fault that is on meets it."""
        path = self.folder / "gelgate.db"
        with self.sparing(), closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
            return connection.execute(query, values).fetchall()

    def forget(self) -> None:
        """A new process has no connection."""
        self._new.clear()
        self.copy, self.kill_in, self.killed_at, self.lost = None, None, "", None

    def attach(self) -> None:
        """Listen to the connections that were made; the event comes before one is ready."""
        for connection in tuple(self._new):
            try:
                connection.set_trace_callback(self._statement)
            except sqlite3.Error as error:
                if "closed" not in str(error):  # not ready yet
                    continue
            self._new.remove(connection)

    def _statement(self, statement: str) -> None:
        """Between these the files stay as they are: what a transaction writes comes with its COMMIT."""
        if (word := statement.partition(" ")[0]) in TRANSACTION:
            self._point(word)

    def _write_file(self, event: str, path: object, *new: object) -> None:
        if not isinstance(path, str | Path) or not str(path).startswith(str(self.folder)):
            return
        self._point(f"{event} {Path(path).suffix}")
        if self.is_full and event == "open" and not os.path.exists(path):
            raise OSError(28, "No space left on device", str(path))
        if self.unsynced is not None and event != "os.mkdir":
            self.unsynced.note_name(event, Path(path), *(Path(str(one)) for one in new))

    def _point(self, name: str) -> None:
        self.points += 1
        if self.kill_in is None or self.is_dead:
            return
        self.kill_in -= 1
        if self.kill_in <= 0:
            self._is_copying = True
            copy = self.folder.with_name(f"{self.folder.name}-after")
            shutil.rmtree(copy, ignore_errors=True)  # of a try that met a file which was just removed
            try:
                shutil.copytree(self.folder, copy)
                if self.lost is not None and self.unsynced is not None:
                    self.lost(self.unsynced, copy)
            finally:
                self._is_copying = False
            self.copy, self.killed_at = copy, name


_heard: Disk | None = None


def hear_audits(disk: Disk | None) -> None:
    """Let this disk hear the interpreter's audit events from now on; None: no disk."""
    global _heard
    _heard = disk
    _add_hook()


@cache
def _add_hook() -> None:
    """Once in a process, for the interpreter never forgets a hook."""

    def hear(event: str, arguments: tuple[Any, ...]) -> None:
        if _heard is not None:
            _heard.hear(event, arguments)

    sys.addaudithook(hear)
