"""A database of a station, read and changed by a test."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from edge.store.press_store import Store

__all__ = ["add_presses", "connection_of", "count_steps", "execute"]


def execute(path: Path, *statements: str, given: tuple[object, ...] = ()) -> list[Any]:
    """Execute statements as one transaction; return the rows of the last one. given: what it has in place of `?`."""
    with closing(sqlite3.connect(path, timeout=30)) as connection, connection:
        for statement in statements[:-1]:
            connection.execute(statement)
        return connection.execute(statements[-1], given).fetchall()


def add_presses(path: Path, number: int) -> None:
    """Add presses to a history that has been read once, with nothing else."""
    execute(
        path,
        f"WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {number}) "
        "INSERT INTO presses (press_id, time_ns, serial, gel_id, part, verdict) "
        "SELECT printf('01J%023d', i), i, '2BNN4ZE7', '2BNN4ZE7-1', 'bolt', 'pass' FROM n",
    )


@contextmanager
def count_steps(connection: sqlite3.Connection) -> Iterator[list[None]]:
    """Count the steps of SQLite, in tens: the length of the list."""
    steps = list[None]()
    connection.set_progress_handler(lambda: steps.append(None), 10)
    try:
        yield steps
    finally:
        connection.set_progress_handler(None, 0)


def connection_of(store: Store) -> sqlite3.Connection:
    """Return the connection of a store."""
    return store.read("counting steps", lambda connection: connection)
