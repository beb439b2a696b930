"""A press to record, and the history of parts: the table of their presses, of which the newest are kept.

Functions that take a connection run inside the caller's transaction.
"""

import sqlite3
from dataclasses import dataclass
from typing import Final

from edge.core.errors import StoreError
from edge.store import ledger_chain
from edge.store.database import insert
from edge.store.ulid import is_ulid

__all__ = ["KEPT_PRESSES", "VERDICTS", "History", "PressRecord", "cut_history", "find_number"]

VERDICTS: Final = ("pass", "fail", "unsure", "rejected", "error")


@dataclass(frozen=True)
class PressRecord:
    """One press to record."""

    press_id: str
    """A ULID."""
    time_ns: int
    """Wall clock."""
    serial: str
    """The sensor's."""
    part: str
    verdict: str
    """Pass, fail, unsure, rejected, or error for a press that could not be scored."""
    position: str | None = None
    score: float | None = None
    threshold: float | None = None
    wear_index: float | None = None
    """Optical wear just before this press; None if not measured."""
    cause: str | None = None
    """The cause of a fail or unsure, where it is known: part, gel or unsure."""
    evidence: bytes | None = None
    """SHA-256 of its record in the archive; None where it has none."""
    second_of: str | None = None
    """Id of the first press of the same piece, where this one was asked for."""

    def __post_init__(self) -> None:
        if not is_ulid(self.press_id):
            raise ValueError(f"a press id is a ULID, found {self.press_id!r}")
        if self.verdict not in VERDICTS:
            raise ValueError(f"a recorded verdict is one of {', '.join(VERDICTS)}, found {self.verdict!r}")
        if not self.serial or not self.part:
            raise ValueError(f"a press has a sensor and a part, found {self.serial!r} and {self.part!r}")


# Rows kept in the press history; about 350 bytes each with their links, so 350 MB. The ledger's counts do not depend on
# them.
KEPT_PRESSES: Final = 1_000_000


class History:
    """The history of parts."""

    name = "presses"

    def insert(self, connection: sqlite3.Connection, press: PressRecord, gel_id: str, running_ns: int) -> int:
        """Add the press to the history and return its number, which SQLite's AUTOINCREMENT never uses twice."""
        (gel_presses,) = connection.execute(
            "SELECT presses FROM gels WHERE serial = ? AND removed_ns IS NULL", (press.serial,)
        ).fetchone()
        row = {**vars(press), "gel_id": gel_id, "running_ns": running_ns, "gel_presses": gel_presses}
        del row["wear_index"]  # of the gel
        return insert(connection, "presses", row)


def find_number(connection: sqlite3.Connection, table: str, press: PressRecord) -> int | None:
    """Find the number of a press that is recorded already. Errors: StoreError when the id is another press's."""
    row = connection.execute(
        f"SELECT number, serial, time_ns, verdict, score FROM {table} WHERE press_id = ?", (press.press_id,)
    ).fetchone()
    if row is None:
        return None
    if row[1:] != (press.serial, press.time_ns, press.verdict, press.score):
        raise StoreError(f"press id {press.press_id} was already given to another press")
    return int(row[0])


def cut_history(connection: sqlite3.Connection) -> None:
    """Keep the newest presses, and up to a thousandth more, so that they go in groups."""
    first, last = connection.execute("SELECT min(number), max(number) FROM presses").fetchone()
    if first is None or last - first < KEPT_PRESSES + KEPT_PRESSES // 1000:
        return
    connection.execute("DELETE FROM presses WHERE number <= ?", (last - KEPT_PRESSES,))
    ledger_chain.cut(connection, last - KEPT_PRESSES)
