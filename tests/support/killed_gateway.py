"""A gateway process that is killed at its n-th write after the first press settled.

`main(config, n)` is a process's whole life; n = 0 lives. How many writes there were is left in `writes` beside the
configuration.
"""

import logging
import os
import sqlite3
import threading
import time
from pathlib import Path

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.gateway import Gateway
from edge.store.outbox import Outbox

WRITES = ("INSERT", "UPDATE", "DELETE", "COMMIT")
KILLED = 9
# Only a broker that is lost lets a run wait for so long.
DELIVERY_S = 100.0


class Deadline(logging.Handler):
    """Armed by the log line of the settled press; then every SQL write counts."""

    def __init__(self, deadly: int) -> None:
        super().__init__()
        self.deadly, self.writes, self.is_armed = deadly, 0, False

    def emit(self, record: logging.LogRecord) -> None:
        self.is_armed = self.is_armed or "PressSettled" in record.getMessage()

    def statement(self, sql: str) -> None:
        if self.is_armed and sql.lstrip().upper().startswith(WRITES):
            self.writes += 1
            if self.writes == self.deadly:
                os._exit(KILLED)


def _await_delivery(database: Path) -> None:
    """The recording is over sooner than its messages are sent; a gateway that lives has nothing left to send."""
    outbox = Outbox(database)
    deadline = time.monotonic() + DELIVERY_S
    while outbox.status().rows and time.monotonic() < deadline:
        time.sleep(0.01)
    outbox.close()


def main(config: Path, deadly: int) -> None:
    deadline = Deadline(deadly)
    logging.getLogger("edge.gateway").setLevel(logging.DEBUG)
    logging.getLogger("edge.gateway").addHandler(deadline)
    connect = sqlite3.connect

    def traced(*arguments: object, **options: object) -> sqlite3.Connection:
        connection: sqlite3.Connection = connect(*arguments, **options)  # type: ignore[call-overload]
        connection.set_trace_callback(deadline.statement)
        return connection

    sqlite3.connect = traced  # type: ignore[assignment]
    loaded = load_config(config)
    with Gateway.open(loaded, SystemClock()) as gateway:
        gateway.run(threading.Event())
        _await_delivery(loaded.store.path)
    (config.parent / "writes").write_text(str(deadline.writes))
