"""The table of reference presses: what each gave, and one that the command line asks for.

Functions that take a connection run inside the caller's transaction.
"""

import sqlite3
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, NamedTuple

from edge.core.reference_press.charts import ReferencePress
from edge.core.reference_press.outcome import Imprint
from edge.store.database import insert, open_read_only
from edge.store.gel_ledger import GelRecord
from edge.store.press_store import PressRecord, Store

__all__ = [
    "PieceKey",
    "ReferenceRequest",
    "ReferenceTable",
    "after",
    "ask",
    "newest_number",
    "of_piece",
    "read_pieces",
    "take",
    "take_request",
    "withdraw",
]

# Rows kept: with one at each of three shifts these are 90 years.
KEPT_REFERENCES: Final = 100_000

_COLUMNS: Final = (
    "press_id, time_ns, gel_id, bundle_id, expected, verdict, score, threshold, strength_levels, x_mm, y_mm, turn_deg, "
    "noise_levels, reason, is_start"
)


class PieceKey(NamedTuple):
    """One master piece at one position of a part, on one sensor: its presses are compared with each other."""

    serial: str
    part: str
    position: str
    piece: str

    def __str__(self) -> str:
        return f"{self.piece} at {self.part}/{self.position}, sensor {self.serial}"


@dataclass(frozen=True)
class ReferenceRequest:
    """What the command line asks the gateway for."""

    request: str
    """An id."""
    who: str
    piece: str | None
    """The master piece; None where the station has one only."""
    is_start: bool
    """Its charts begin again."""
    time_ns: int


class ReferenceTable:
    """A press of this master piece, as `PressTable`. presses: of the piece, with this one, once it is inserted."""

    name = "reference_presses"

    def __init__(self, key: PieceKey, press: ReferencePress) -> None:
        self.presses: list[ReferencePress] = []
        self._key = key
        self._press = press

    def insert(
        self, connection: sqlite3.Connection, press: PressRecord, gel: GelRecord, running_ns: int
    ) -> int:
        reference = self._press
        own = ("bundle_id", "expected", "verdict", "reason", "score", "threshold")
        row = {
            **self._key._asdict(),
            **{name: getattr(reference, name) for name in own},
            **vars(reference.imprint),
            "press_id": press.press_id,
            "time_ns": press.time_ns,
            "running_ns": running_ns,
            "gel_id": gel.gel_id,
            "is_start": int(reference.is_start),
        }
        number = insert(connection, "reference_presses", row)
        connection.execute(
            "DELETE FROM reference_presses WHERE number <= (SELECT max(number) FROM reference_presses) - ?",
            (KEPT_REFERENCES,),
        )
        self.presses = of_piece(connection, self._key)
        return number


def of_piece(connection: sqlite3.Connection, key: PieceKey) -> list[ReferencePress]:
    """Every press of this piece, oldest first."""
    rows = connection.execute(
        f"SELECT {_COLUMNS} FROM reference_presses WHERE serial = ? AND part = ? AND position = ? AND piece = ? "
        "ORDER BY number",
        key,
    )
    return [_press(row) for row in rows]


def newest_number(connection: sqlite3.Connection) -> int:
    """Read the number of the newest reference press of this database, 0 without one."""
    return int(connection.execute("SELECT coalesce(max(number), 0) FROM reference_presses").fetchone()[0])


def after(connection: sqlite3.Connection, number: int) -> list[ReferencePress] | None:
    """The presses of the piece of the first press after this number, up to it; None where there is none yet."""
    row = connection.execute(
        "SELECT serial, part, position, piece, press_id FROM reference_presses WHERE number > ? ORDER BY number",
        (number,),
    ).fetchone()
    if row is None:
        return None
    presses = of_piece(connection, PieceKey(*row[:4]))
    ids = [press.press_id for press in presses]
    return presses[: ids.index(row[4]) + 1]


def ask(connection: sqlite3.Connection, wish: ReferenceRequest) -> None:
    """The gateway takes it within seconds; it replaces one that waits."""
    connection.execute(
        "INSERT OR REPLACE INTO reference_request (one, request, who, piece, is_start, time_ns) "
        "VALUES (1, ?, ?, ?, ?, ?)",
        (wish.request, wish.who, wish.piece, int(wish.is_start), wish.time_ns),
    )


def take(store: Store) -> ReferenceRequest | None:
    """Take the waiting request out of the database; without one, nothing is written. Errors: StoreError."""
    doing, waiting = "reading what the command line asks for", "SELECT 1 FROM reference_request"
    if store.read(doing, lambda connection: connection.execute(waiting).fetchone()) is None:
        return None
    return store.write(doing, take_request)


def take_request(connection: sqlite3.Connection) -> ReferenceRequest | None:
    """Take the waiting request out of the table."""
    row = connection.execute(
        "DELETE FROM reference_request RETURNING request, who, piece, is_start, time_ns"
    ).fetchone()
    return None if row is None else ReferenceRequest(row[0], row[1], row[2], bool(row[3]), row[4])


def withdraw(connection: sqlite3.Connection, request: str) -> bool:
    """Ask for it no more; returns whether it was still waiting."""
    gone = connection.execute("DELETE FROM reference_request WHERE request = ?", (request,))
    return gone.rowcount > 0


def read_pieces(path: Path) -> dict[PieceKey, list[ReferencePress]]:
    """Every master piece with its presses, oldest first; also while a gateway runs. Errors: StoreError."""
    with open_read_only(path, "reading the reference presses") as connection:
        keys = connection.execute(
            "SELECT DISTINCT serial, part, position, piece FROM reference_presses ORDER BY 1, 2, 3, 4"
        ).fetchall()
        return {PieceKey(*key): of_piece(connection, PieceKey(*key)) for key in keys}


def _press(row: tuple[Any, ...]) -> ReferencePress:
    values = dict(zip(_COLUMNS.split(", "), row, strict=True))
    imprint = Imprint(**{field.name: values.pop(field.name) for field in fields(Imprint)})
    return ReferencePress(**{**values, "is_start": bool(values["is_start"])}, imprint=imprint)
