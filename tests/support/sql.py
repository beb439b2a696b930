"""A database of a station, read and changed by a test."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

__all__ = ["add_presses", "count_steps", "execute"]


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
def count_steps() -> Iterator[list[int]]:
    """Count the steps of SQLite, in hundreds, on the connections that are opened inside: the length of the list."""
    steps, connect = list[int](), sqlite3.connect

    def connect_and_count(*given: Any, **named: Any) -> sqlite3.Connection:
        connection = connect(*given, **named)
        connection.set_progress_handler(lambda: steps.append(100), 100)
        return connection

    with patch("sqlite3.connect", connect_and_count):
        yield steps
