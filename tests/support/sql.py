"""A database of a station, read and changed by a test."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

__all__ = ["execute"]


def execute(path: Path, *statements: str, given: tuple[object, ...] = ()) -> list[Any]:
    """Execute statements as one transaction; return the rows of the last one. given: what it has in place of `?`."""
    with closing(sqlite3.connect(path, timeout=30)) as connection, connection:
        for statement in statements[:-1]:
            connection.execute(statement)
        return connection.execute(statements[-1], given).fetchall()
