"""The bundles in use: the newest revision of each position of each part, and which position is selected.

Runs inside the caller's transaction.
"""

import sqlite3

from edge.core.part_position import PartPosition

__all__ = ["read_selected", "read_takeover", "revision", "use"]


def revision(connection: sqlite3.Connection, part: PartPosition) -> int | None:
    """Read the revision of the newest bundle in use; None where no bundle had one."""
    row = connection.execute(
        "SELECT revision FROM bundles_in_use WHERE part = ? AND position = ?", part
    ).fetchone()
    return None if row is None or row[0] is None else int(row[0])


def read_selected(connection: sqlite3.Connection) -> PartPosition | None:
    """Read the position that was selected last."""
    row = connection.execute("SELECT part, position FROM selected").fetchone()
    return None if row is None else PartPosition(*row)


def read_takeover(connection: sqlite3.Connection, part: PartPosition) -> tuple[str, str] | None:
    """Read which configured bundle was replaced by which shadow, by their ids; None where none was."""
    row = connection.execute(
        "SELECT instead_of, bundle_id FROM bundles_in_use WHERE part = ? AND position = ?", part
    ).fetchone()
    return None if row is None or row[0] is None else (row[0], row[1])


def use(
    connection: sqlite3.Connection,
    part: PartPosition,
    number: int | None,
    bundle_id: str,
    time_ns: int,
    instead_of: str | None = None,
) -> None:
    """This bundle inspects from now on. A lower revision than before is one that was allowed: it is the newest now.
    instead_of: the configured bundle whose place it has taken."""
    connection.execute(
        "INSERT INTO bundles_in_use VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (part, position) DO UPDATE SET "
        "revision = excluded.revision, bundle_id = excluded.bundle_id, time_ns = excluded.time_ns, "
        "instead_of = excluded.instead_of",
        (*part, number, bundle_id, time_ns, instead_of),
    )
    connection.execute(
        "INSERT INTO selected VALUES (1, ?, ?) ON CONFLICT (one) DO UPDATE SET part = excluded.part, "
        "position = excluded.position",
        part,
    )
