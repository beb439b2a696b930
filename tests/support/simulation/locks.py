"""Another program that locks the station's database, and the threads of the station that wait for it.

The lock is a real one, of a connection of its own. SQLite asks again and again, and sleeps between: that sleep is of
the run's time, and others take their turns meanwhile.
"""

import sqlite3
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from greenlet import GreenletExit, getcurrent

from simulation.sensor import S

if TYPE_CHECKING:
    from pathlib import Path

    from simulation.connections import Connections
    from simulation.lives import Station

TAKEN = {
    "writes": ("BEGIN IMMEDIATE",),
    "reads": ("BEGIN", "SELECT count(*) FROM presses"),
    "is alone": ("PRAGMA locking_mode = EXCLUSIVE", "BEGIN IMMEDIATE", "COMMIT"),
}
"""A shell or another gateway, a check or a backup, and a tool that finds nobody at work."""


class Locker:
    """The other program. kind: how it has the file; empty for not at all."""

    def __init__(self, path: "Path") -> None:
        self._path, self.kind = path, ""
        self.left_ns = 0
        """When it left the file last."""
        self._connection: sqlite3.Connection | None = None

    @property
    def is_refusing(self) -> bool:
        """Nobody else can write."""
        return self.kind not in ("", "reads")

    def take(self, kind: str) -> bool:
        """Lock it; returns whether it could, for the station may be writing."""
        if self._connection is not None or not self._path.exists():
            return False
        self._connection = connection = sqlite3.connect(self._path, timeout=0, isolation_level=None)
        try:
            for statement in TAKEN[kind]:
                connection.execute(statement).fetchall()
        except sqlite3.OperationalError:  # it is busy
            self.leave()
            return False
        self.kind = kind
        return True

    def leave(self) -> None:
        """End, after a checkpoint where it read."""
        if self._connection is not None:
            with suppress(sqlite3.OperationalError):  # no room, or the disk fails
                if self._connection.in_transaction:
                    self._connection.execute("COMMIT")
                if self.kind == "reads":
                    self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
            self._connection.close()
        self._connection, self.kind = None, ""


class DatabaseLock:
    """The lock of a connection of the station, in which a turn may wait: who wants it too lets that turn go on."""

    def __init__(self, connections: "Connections", real: Any) -> None:
        self._connections, self._real = connections, real
        self._owner: object = None
        self._depth, self._thread = 0, threading.get_ident()

    @property
    def is_held(self) -> bool:
        """A turn waits in it."""
        return self._owner not in (None, getcurrent())

    def __enter__(self) -> None:
        if threading.get_ident() == self._thread:
            if self.is_held and getcurrent().parent is not None:
                self._connections.wait(lambda: not self.is_held, 3600, 0.01)
            while self.is_held:
                self._let_go_on()
            self._owner, self._depth = getcurrent(), self._depth + 1
        self._real.acquire()

    def __exit__(self, *_: object) -> None:
        self._real.release()
        if threading.get_ident() == self._thread:
            self._depth -= 1
            self._owner = self._owner if self._depth else None

    def _let_go_on(self) -> None:
        (turns,) = (one for one in self._connections.turns.values() if one.is_of(self._owner))
        self._connections.let_all_wait(max(0.001, turns.act()))


class SharedDatabase:
    """The database of a station, for which its threads wait while another program has locked it."""

    def __init__(self, connections: "Connections") -> None:
        self._connections, self._store_lock = connections, DatabaseLock(connections, threading.RLock())
        self.has_waited = False
        """The loop did."""

    @property
    def is_store_held(self) -> bool:
        """A turn waits in the middle of a transaction of the store."""
        return self._store_lock.is_held

    def begin(self, station: "Station") -> None:
        """Let others take their turns while one of this life waits."""
        self._station, parts = station, station.loop.parts
        self._connections.let_all_wait = self._let_all_wait
        if station.disk.unsynced is not None:
            station.disk.unsynced.at_sleep = self._sleep
        for database in (parts.publisher._outbox._database, parts.store._database):
            self._store_lock = DatabaseLock(self._connections, database._lock)
            database._lock = self._store_lock  # type: ignore[assignment]

    def _let_all_wait(self, seconds: float) -> None:
        """A thread that is no turn waits, and so all do. Nobody could open a board that was plugged in meanwhile."""
        self._station._since.clear()
        self._station.world.relay.well_since_ns += round(seconds * S)
        self._connections.clock.sleep(seconds)

    def _sleep(self, seconds: float) -> None:
        """Wait in the middle of a statement; a loop that waits hangs."""
        station, clock = self._station, self._connections.clock
        if getcurrent().parent is None or self._connections.is_ending:
            self._let_all_wait(seconds)
            return
        began_ns, is_loop = clock.now_ns, self._connections.turns["loop"].is_of(getcurrent())
        station.is_hanging |= is_loop
        try:
            self._connections.wait(lambda: False, seconds)
        except GreenletExit:  # the process is gone: the statement ends, and with it the turn
            self._connections.is_ending = True
        if is_loop:
            station.is_hanging, self.has_waited = False, True
            if station.hung and station.hung[-1][1] == began_ns:
                began_ns = station.hung.pop()[0]
            station.hung.append((began_ns, clock.now_ns))
