"""A station that is killed at its n-th write after the first press settled.

`main(config, n)` is a process's whole life; n = 0 lives. How many writes there were is left in `writes` beside the
configuration.
"""

import logging
import os
import sqlite3
from pathlib import Path

from stepped_station import SteppedStation

WRITES = ("INSERT", "UPDATE", "DELETE", "COMMIT")
KILLED = 9


class Deadline(logging.Handler):
    """Armed by the log line of the settled press; then every SQL write counts, those of its triggers as one with it."""

    def __init__(self, deadly: int) -> None:
        super().__init__()
        self.deadly, self.writes, self.is_armed = deadly, 0, False
        self._last = ""

    def emit(self, record: logging.LogRecord) -> None:
        self.is_armed = self.is_armed or "PressSettled" in record.getMessage()

    def count(self, sql: str) -> None:
        if self.is_armed and sql != self._last and sql.lstrip().upper().startswith(WRITES):
            self.writes, self._last = self.writes + 1, sql
            if self.writes == self.deadly:
                os._exit(KILLED)


def main(config: Path, deadly: int) -> None:
    deadline, connect = Deadline(deadly), sqlite3.connect
    logging.getLogger("edge.gateway").setLevel(logging.DEBUG)
    logging.getLogger("edge.gateway").addHandler(deadline)

    def connect_counted(*arguments: object, **options: object) -> sqlite3.Connection:
        connection: sqlite3.Connection = connect(*arguments, **options)  # type: ignore[call-overload]
        connection.set_trace_callback(deadline.count)
        return connection

    sqlite3.connect = connect_counted  # type: ignore[assignment]
    with SteppedStation(config) as station:
        while not station.has_ended:
            station.play(1)
            station.publish()
    (config.parent / "writes").write_text(str(deadline.writes))
