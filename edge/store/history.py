"""The history of presses: which of them, by time, part, gel and verdict; as rows, and as CSV or Parquet.

It reads one state of the database and writes nothing there, so it may be asked while a gateway runs.
"""

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import astuple, dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Final

from edge.core.errors import ArchiveError, StoreError
from edge.core.person_verdict import settle
from edge.store.database import open_read_only
from edge.store.ledger_chain import head
from edge.store.person_verdicts import read_verdicts

__all__ = [
    "COLUMNS",
    "FORMATS",
    "MEASURED",
    "HistoryQuery",
    "HistoryRow",
    "KnownPress",
    "count_verdicts",
    "find_press",
    "list_parts",
    "presses_since",
    "read_history",
    "write_history",
]


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
    person_verdict: str | None = None
    """What people say: good, damaged, gel or cannot_tell; None where nobody spoke."""
    damage_kind: str | None = None
    """The kind of damage that a person named."""
    person: str | None = None
    shadow: str | None = None
    """What the shadow bundle says, JSON (`edge.core.press.ShadowVerdict`); None without one."""
    piece_id: str | None = None
    """The piece of several places that it is of, each part and position a place; None without one."""
    depth_mm: float | None = None
    """How much deeper the part is at its highest score than a good one; None where it is not told, as of the next."""
    depth_u95_mm: float | None = None
    size_mm: float | None = None
    size_u95_mm: float | None = None


COLUMNS: Final = tuple(field.name for field in fields(HistoryRow))

MEASURED: Final = ("depth_mm", "depth_u95_mm", "size_mm", "size_u95_mm")
"""A deviation, as fields of `edge.messaging.deviation_payload.DeviationPlace`."""

# These come from the acts, the others from the table of presses.
_OF_PEOPLE: Final = ("person_verdict", "damage_kind", "person")
_STORED: Final = tuple(name for name in COLUMNS if name not in _OF_PEOPLE)
_OF_GEL_SERIAL: Final = "SELECT serial, gel_id FROM gels WHERE gel_serial = ? COLLATE NOCASE"


@dataclass(frozen=True)
class HistoryQuery:
    """Every condition that is given must hold."""

    since_ns: int | None = None
    """From this moment on."""
    until_ns: int | None = None
    """Before this moment."""
    part: str | None = None
    position: str | None = None
    serial: str | None = None
    gel: str | None = None
    """Its id, or its own serial."""
    verdicts: tuple[str, ...] = ()
    """One of these."""
    newest: int | None = None
    """At most this number of presses, the newest that fit."""

    def where(self) -> tuple[str, list[object]]:
        """The SQL condition and its values."""
        asked: list[tuple[str, object]] = [("time_ns >= ?", self.since_ns), ("time_ns < ?", self.until_ns)]
        asked += [(f"{name} = ?", getattr(self, name)) for name in ("part", "position", "serial")]
        terms = [(term, value) for term, value in asked if value is not None]
        words, values = [term for term, _ in terms], [value for _, value in terms]
        if self.gel is not None:
            words.append(f"(gel_id = ? OR (serial, gel_id) IN ({_OF_GEL_SERIAL}))")
            values += [self.gel, self.gel]
        if self.verdicts:
            words.append(f"verdict IN ({', '.join('?' * len(self.verdicts))})")
            values += self.verdicts
        return " AND ".join(words) or "1", values


def read_history(path: Path, query: HistoryQuery) -> Iterator[HistoryRow]:
    """The presses that fit, oldest first, one at a time. Errors: StoreError."""
    condition, values = query.where()
    limit = -1 if query.newest is None else query.newest
    columns = ", ".join("running_ns / 1e9" if name == "running_s" else name for name in _STORED)
    with open_read_only(path, "reading the history") as connection:
        verdicts = read_verdicts(connection)
        rows = connection.execute(
            f"SELECT {columns} FROM presses WHERE number IN (SELECT number FROM presses WHERE {condition} "
            "ORDER BY number DESC LIMIT ?) ORDER BY number",
            (*values, limit),
        )
        for row in rows:
            stored = dict(zip(_STORED, row, strict=True))
            settled = settle(verdicts.get(stored["press_id"], ()))
            people = (settled.saying, settled.kind, settled.person) if settled else (None, None, None)
            stored.update(zip(_OF_PEOPLE, people, strict=True))
            yield HistoryRow(**stored)


def count_verdicts(path: Path, query: HistoryQuery) -> Mapping[str, int]:
    """Count the presses that fit by verdict; all of them, whatever `newest` says. Errors: StoreError."""
    condition, values = query.where()
    with open_read_only(path, "reading the history") as connection:
        counted = f"SELECT verdict, COUNT(*) FROM presses WHERE {condition} GROUP BY verdict ORDER BY verdict"
        return dict(connection.execute(counted, values).fetchall())


def list_parts(path: Path) -> list[str]:
    """List the parts and positions that were pressed. Errors: StoreError."""
    with open_read_only(path, "reading the history") as connection:
        rows = connection.execute("SELECT DISTINCT part, position FROM presses ORDER BY part, position")
        return [f"{part}/{position or '-'}" for part, position in rows]


# Rows of one row group of a Parquet file; all of them are in memory at once.
GROUP_ROWS: Final = 50_000


def write_history(path: Path, rows: Iterable[HistoryRow]) -> int:
    """Write the rows to a file whose ending names its format; returns their number. A file of that name is replaced.

    The file appears complete or not at all, and rows are written as they are read.

    Errors: StoreError for an ending that is no format, or a folder that cannot be written.
    """
    write = FORMATS.get(path.suffix.lower())
    if write is None:
        raise StoreError(f"the ending of {path} names no format; known are {', '.join(FORMATS)}")
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    number = 0

    def counted() -> Iterator[HistoryRow]:
        nonlocal number
        for number, row in enumerate(rows, 1):  # noqa: B007  # it is returned
            yield row

    try:
        write(part, counted())
        os.replace(part, path)
    except OSError as error:
        raise StoreError(
            f"file {path} cannot be written: {error.strerror or error}; check its folder and the free space"
        ) from error
    finally:
        part.unlink(missing_ok=True)
    return number


def _write_csv(path: Path, rows: Iterator[HistoryRow]) -> None:
    """Write a row of column names, then the presses. An empty cell is a missing value."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(map(astuple, rows))


def _write_parquet(path: Path, rows: Iterator[HistoryRow]) -> None:
    """Column `time_ns` is a moment in UTC, so that programs need no conversion."""
    import pyarrow as pa
    from pyarrow import parquet

    types = {"number": pa.int64(), "time_ns": pa.timestamp("ns", "UTC")}
    types |= {name: pa.float64() for name in ("running_s", "score", "threshold", *MEASURED)}
    schema = pa.schema([(name, types.get(name, pa.string())) for name in COLUMNS])
    with parquet.ParquetWriter(path, schema) as writer:
        while group := list(map(vars, islice(rows, GROUP_ROWS))):
            writer.write_table(pa.Table.from_pylist(group, schema))


FORMATS: Final[Mapping[str, Callable[[Path, Iterator[HistoryRow]], None]]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
}
"""Ending of a file's name to what writes it."""


# A prefix that fits more presses is answered with this number of them.
_SHOWN = 4


@dataclass(frozen=True)
class KnownPress:
    """number: its `sequence`. evidence: SHA-256 of its record in the archive, None where it has none."""

    number: int
    press_id: str
    time_ns: int
    evidence: bytes | None


def find_press(database: Path, prefix: str) -> KnownPress:
    """The press with this number or id, or the only one whose id begins so. Errors: ArchiveError, StoreError."""
    wanted = prefix.strip().upper()
    if not wanted.isalnum() or not wanted.isascii():
        raise ArchiveError(f"'{prefix:.60}' is no press; give its number, its id, or the id's beginning")
    condition = "CAST(number AS TEXT) = ? OR press_id >= ? AND press_id < ?"  # an id begins with 0
    presses = list(_presses(database, condition, (wanted, wanted, wanted + "~"), _SHOWN + 1))
    if len(presses) > 1:
        ids = ", ".join(press.press_id for press in presses[:_SHOWN])
        more = " and more" if len(presses) > _SHOWN else ""
        raise ArchiveError(f"'{prefix}' is the beginning of {ids}{more}; give more of the id")
    if not presses:
        raise ArchiveError(f"no press {prefix:.60} is in {_describe(database)}; is it another station's?")
    return presses[0]


def presses_since(database: Path, since_ns: int | None = None) -> Iterator[KnownPress]:
    """Every press from this moment on, oldest first. Errors: ArchiveError, StoreError."""
    return _presses(database, "time_ns >= ?", (since_ns or 0,), -1)


def _presses(database: Path, condition: str, values: tuple[object, ...], limit: int) -> Iterator[KnownPress]:
    with open_read_only(database, "reading what is archived") as connection:
        query = f"SELECT number, press_id, time_ns, evidence FROM presses WHERE {condition} ORDER BY number LIMIT ?"
        for row in connection.execute(query, (*values, limit)):
            yield KnownPress(*row)


def _describe(database: Path) -> str:
    """Describe the database: which ledger, and which presses it has."""
    with open_read_only(database, "reading what is archived") as connection:
        ledger_id = head(connection).ledger_id
        query = "SELECT count(*), min(press_id), max(press_id) FROM presses"
        presses, first, last = connection.execute(query).fetchone()
    which = f", {first} to {last}" if presses else ""
    return f"database {database} (ledger {ledger_id}, {presses} presses{which})"
