"""What a check of the database finds: SQLite's own integrity, counts against presses, the outbox against its totals.

It writes nothing, so it may run while a gateway does. A *fault* is something that no gelgate writes. A *note* has an
explanation in normal work, such as presses that were counted while the disk was full.
"""

import json
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from edge.store.database import open_read_only
from edge.store.ledger_chain import Head
from edge.store.ledger_check import Finding, chain_findings
from edge.store.outbox import ROW_OVERHEAD_BYTES
from edge.store.press_counts import Count, PressCounts
from edge.store.ulid import is_ulid

__all__ = ["Finding", "check_database"]

# SQLite reports at most this number of damaged places.
MOST_DAMAGES: Final = 10


def check_database(path: Path, held: Head | None = None) -> list[Finding]:
    """Everything that is wrong or worth knowing; empty for a sound database.

    held: a head of the ledger that was published earlier and kept elsewhere; it must be in the chain still. Errors:
    StoreError for a file that cannot be read, is of another program, or has another version.
    """
    counts = PressCounts(path).read()  # before the database: a press that comes between makes it only newer
    with open_read_only(path, "checking") as connection:
        damages = list(_file(connection))
        # Rows of a damaged file say nothing that can be relied on.
        return damages or [
            *_presses(connection),
            *_gels(connection),
            *_counts(connection, counts),
            *_outbox(connection),
            *chain_findings(connection, held),
        ]


def _file(connection: sqlite3.Connection) -> Iterator[Finding]:
    try:
        lines = [str(row[0]) for row in connection.execute(f"PRAGMA integrity_check({MOST_DAMAGES})")]
    except sqlite3.DatabaseError as error:  # damage that stops even the check
        if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_CORRUPT:
            raise
        lines = [str(error)]
    yield from (Finding("file", f"it is damaged: {' '.join(line.split())}") for line in lines if line != "ok")


def _presses(connection: sqlite3.Connection) -> Iterator[Finding]:
    """Ids are ULIDs; no number is missing between the first and the last; each press has its gel."""
    wrong = [
        number
        for number, press_id in connection.execute("SELECT number, press_id FROM presses")
        if not is_ulid(press_id)
    ]
    if wrong:
        yield Finding("presses", f"{len(wrong)} have an id that is no ULID; the first is number {wrong[0]}")
    first, last, rows = connection.execute(
        "SELECT coalesce(min(number), 0), coalesce(max(number), -1), count(*) FROM presses"
    ).fetchone()
    if missing := last - first + 1 - rows:
        yield Finding(
            "presses",
            f"{missing} numbers between {first} and {last} are missing; a database that was removed or replaced by "
            "an old copy leaves such a gap",
            is_fault=False,
        )
    orphans = connection.execute(
        "SELECT count(*) FROM presses WHERE NOT EXISTS (SELECT 1 FROM gels WHERE gels.serial = presses.serial "
        "AND gels.gel_id = presses.gel_id)"
    ).fetchone()[0]
    if orphans:
        yield Finding("presses", f"{orphans} are of gels that are not in the ledger")


# Those of parts, of master pieces and of gauge studies.
_EVERY_PRESS: Final = " UNION ALL ".join(
    f"SELECT serial, gel_id FROM {table}" for table in ("presses", "reference_presses", "study_presses")
)


def _gels(connection: sqlite3.Connection) -> Iterator[Finding]:
    """A gel has been pressed at least as often as the history says, and as often unless there is a reason."""
    (oldest,) = connection.execute("SELECT coalesce(min(number), 1) FROM presses").fetchone()
    rows = connection.execute(
        f"SELECT gel_id, serial, presses, (SELECT count(*) FROM ({_EVERY_PRESS}) AS p WHERE p.serial = gels.serial "
        "AND p.gel_id = gels.gel_id) FROM gels ORDER BY serial, gels.rowid"
    )
    for gel_id, serial, counted, recorded in rows:
        where = f"gel {gel_id} of sensor {serial} counts {counted} presses, the history has {recorded}"
        if counted < recorded:
            yield Finding("gels", f"{where}: the count was lowered")
        elif counted > recorded:
            why = "older ones have left it" if oldest > 1 else "the others were made while it refused writes"
            yield Finding("gels", f"{where}: {why}, or were in a database that was lost", is_fault=False)


def _counts(connection: sqlite3.Connection, counts: dict[str, Count]) -> Iterator[Finding]:
    """The second record of the counts is never ahead of the database."""
    newest = connection.execute("SELECT seq FROM sqlite_sequence WHERE name = 'presses'").fetchone()
    for serial, known in counts.items():
        gel = connection.execute(
            "SELECT presses FROM gels WHERE serial = ? AND gel_id = ?", (serial, known.gel_id)
        ).fetchone()
        presses, number = (gel[0] if gel else 0), (newest[0] if newest else 0)
        if known.presses > presses or known.sequence > number:
            yield Finding(
                "counts",
                f"the second record has {known.presses} presses of gel {known.gel_id} up to number {known.sequence}, "
                f"the database {presses} up to {number}: it was removed, cut or replaced by an old copy; look for "
                "the lost file, or start the gateway, which goes on from the higher count",
            )
        if known.uncounted:
            yield Finding(
                "counts",
                f"{known.uncounted} presses of sensor {serial} wait to be counted; the next start does",
                is_fault=False,
            )


def _outbox(connection: sqlite3.Connection) -> Iterator[Finding]:
    """Its totals are those of its rows, each row can be sent, and each waiting result has its press."""
    totals = connection.execute("SELECT rows, bytes FROM outbox_size").fetchone()
    counted = connection.execute("SELECT count(*), coalesce(sum(bytes), 0) FROM outbox").fetchone()
    if totals != counted:
        yield Finding(
            "outbox",
            f"it has {counted[0]} rows of {counted[1]} bytes, its totals say {totals[0]} and {totals[1]}",
        )
    (orphans,) = connection.execute(
        "SELECT count(*) FROM settled WHERE row_id NOT IN (SELECT row_id FROM outbox)"
    ).fetchone()
    if orphans:
        yield Finding("outbox", f"{orphans} acknowledgements are of rows that are not there")
    for what, is_wrong in _ROW_FAULTS.items():
        rows = [row[0] for row in connection.execute(_ROWS) if is_wrong(connection, _Row(*row))]
        if rows:
            yield Finding("outbox", f"{len(rows)} rows {what}; the first is row {rows[0]}")
    (refused,) = connection.execute(
        "SELECT count(DISTINCT row_id) FROM settled WHERE refusal IS NOT NULL"
    ).fetchone()
    if refused:
        yield Finding("outbox", f"{refused} rows were refused by a receiver and wait", is_fault=False)


class _Row(NamedTuple):
    """What is checked of a row of the outbox."""

    row_id: int
    topic: str
    content_type: str
    size: int
    payload: bytes


_ROWS: Final = "SELECT row_id, topic, content_type, bytes, payload FROM outbox ORDER BY row_id"


def _has_no_press(connection: sqlite3.Connection, row: _Row) -> bool:
    """Tell whether a row is a result of a press that the history does not have, though it has older ones."""
    content = _content(row.payload) if row.topic == "result" else None
    if not content:
        return False
    press_id = (content.get("press_id"),)
    known = connection.execute("SELECT 1 FROM presses WHERE press_id = ?", press_id).fetchone()
    (oldest,) = connection.execute("SELECT coalesce(min(time_ns), 0) FROM presses").fetchone()
    return known is None and content.get("time_ns", 0) >= oldest


def _content(payload: bytes) -> dict[str, object] | None:
    """Parse a JSON object; None for anything else."""
    try:
        content = json.loads(payload)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


_ROW_FAULTS: Final[dict[str, Callable[[sqlite3.Connection, _Row], bool]]] = {
    "have another size than they say": lambda _, row: row.size != len(row.payload) + ROW_OVERHEAD_BYTES,
    "hold a message that is no JSON": lambda _, row: (
        row.content_type == "application/json" and bool(row.payload) and _content(row.payload) is None
    ),
    "are results of presses that the history does not have": _has_no_press,
}
