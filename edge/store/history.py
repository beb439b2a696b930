"""The history of presses: which of them, by time, part, gel and verdict.

It reads one state of the file and writes nothing, so it may be asked while a gateway runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

from edge.store.database import open_read_only

__all__ = ["COLUMNS", "HistoryQuery", "HistoryRow", "read_history"]


@dataclass(frozen=True)
class HistoryRow:
    """One press of the history."""

    number: int
    """The `sequence` of its result."""
    press_id: str
    time_ns: int
    """Wall clock, nanoseconds since 1970 UTC."""
    running_s: float | None
    """Seconds that gateways had run on this database, whatever the clock did; None for a press of version 1."""
    serial: str
    gel_id: str
    part: str
    position: str | None
    verdict: str
    score: float | None
    """Raw, as the threshold; higher is more anomalous. None for a press without a score."""
    threshold: float | None
    cause: str | None = None
    """The cause of a fail or unsure: part, gel or unsure; None where it is not known."""


COLUMNS: Final = tuple(field.name for field in fields(HistoryRow))


@dataclass(frozen=True)
class HistoryQuery:
    """Every condition that is given must hold. since_ns: from this moment on; until_ns: before this moment. verdicts:
    one of these. newest: at most this number of presses, the newest that fit."""

    since_ns: int | None = None
    until_ns: int | None = None
    part: str | None = None
    position: str | None = None
    serial: str | None = None
    gel_id: str | None = None
    verdicts: tuple[str, ...] = ()
    newest: int | None = None

    def where(self) -> tuple[str, list[object]]:
        """The SQL condition and its values."""
        asked: list[tuple[str, object]] = [("time_ns >= ?", self.since_ns), ("time_ns < ?", self.until_ns)]
        asked += [(f"{name} = ?", getattr(self, name)) for name in ("part", "position", "serial", "gel_id")]
        terms = [(term, value) for term, value in asked if value is not None]
        words, values = [term for term, _ in terms], [value for _, value in terms]
        if self.verdicts:
            words.append(f"verdict IN ({', '.join('?' * len(self.verdicts))})")
            values += self.verdicts
        return " AND ".join(words) or "1", values


def read_history(path: Path, query: HistoryQuery) -> Iterator[HistoryRow]:
    """The presses that fit, oldest first, one at a time. Errors: StoreError."""
    condition, values = query.where()
    limit = -1 if query.newest is None else query.newest
    columns = ", ".join("running_ns / 1e9" if name == "running_s" else name for name in COLUMNS)
    with open_read_only(path, "reading the history") as connection:
        rows = connection.execute(
            f"SELECT {columns} FROM presses WHERE number IN (SELECT number FROM presses WHERE {condition} "
            "ORDER BY number DESC LIMIT ?) ORDER BY number",
            (*values, limit),
        )
        for row in rows:
            yield HistoryRow(*row)
