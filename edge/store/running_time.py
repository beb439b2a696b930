"""The time that a gateway has run on this database: the clock by which messages age.

The wall clock may step by months when a gateway without a clock battery finds a time server, so it says nothing about
age. Running time only goes forward, at the pace of the monotonic clock: it does not count while no gateway runs, and a
crash takes back at most the time since it was last stored. A message is never younger than its running time says.
"""

import sqlite3
import time
from collections.abc import Callable
from typing import Final

__all__ = ["RunningTime"]

# Without presses it is stored this often.
STORED_EVERY_NS: Final = 600 * 10**9


class RunningTime:
    """Use it inside a transaction of the database. monotonic_ns: the monotonic clock."""

    def __init__(self, monotonic_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._monotonic_ns = monotonic_ns
        self._opened_ns = monotonic_ns()
        self._before_ns: int | None = None  # the running time at the first use

    def now_ns(self, connection: sqlite3.Connection) -> int:
        """Nanoseconds that gateways have run on this database, at least as many as at any call before."""
        stored_ns = self._read_stored(connection)
        if self._before_ns is None:
            self._before_ns = stored_ns
        return max(stored_ns, self._before_ns + self._monotonic_ns() - self._opened_ns)

    def store(self, connection: sqlite3.Connection) -> int:
        """Store the running time, and return it in nanoseconds."""
        now_ns = self.now_ns(connection)
        connection.execute("UPDATE running SET running_ns = ?", (now_ns,))
        return now_ns

    def store_sometimes(self, connection: sqlite3.Connection) -> None:
        """Keep it if that was not done for ten minutes."""
        if self.now_ns(connection) - self._read_stored(connection) >= STORED_EVERY_NS:
            self.store(connection)

    @staticmethod
    def _read_stored(connection: sqlite3.Connection) -> int:
        return int(connection.execute("SELECT running_ns FROM running").fetchone()[0])
