"""What a check of the database finds: SQLite's own integrity, counts against presses, the outbox, and the ledger.

It writes nothing, so it may run while a gateway does. A *fault* is something that no gelgate writes. A *note* has an
explanation in normal work, such as presses that were counted while the disk was full.

The ledger still holds what was written where every link follows from the one before, every row agrees with its newest
link, and no chained row is missing or was added: see `edge.store.ledger_chain`.
"""

import hashlib
import json
import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from edge.core.printable import write_count
from edge.store.database import open_read_only
from edge.store.ledger_chain import KIND_OF, KINDS, NO_HASH, Head, canonical, hash_link, read_row
from edge.store.outbox import ROW_OVERHEAD_BYTES
from edge.store.pieces import KEPT_PIECES
from edge.store.press_counts import Count, PressCounts
from edge.store.reference_presses import KEPT_REFERENCES
from edge.store.ulid import is_ulid

__all__ = ["Finding", "check_database"]

# SQLite reports at most this number of damaged places.
MOST_DAMAGES: Final = 10


@dataclass(frozen=True)
class Finding:
    """One sentence about one part: file, presses, gels, counts, outbox or ledger."""

    part: str
    text: str
    is_fault: bool = True


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
            *_ledger(connection, held),
        ]


def _count(connection: sqlite3.Connection, query: str) -> int:
    return int(connection.execute(query).fetchone()[0])


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
    ids = connection.execute("SELECT number, press_id FROM presses")
    wrong = [number for number, press_id in ids if not is_ulid(press_id)]
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
    orphans = "SELECT count(*) FROM presses WHERE (serial, gel_id) NOT IN (SELECT serial, gel_id FROM gels)"
    if number := _count(connection, orphans):
        yield Finding("presses", f"{number} are of gels that are not in the ledger")


# Those of parts, of master pieces and of gauge studies.
_EVERY_PRESS: Final = " UNION ALL ".join(f"SELECT serial, gel_id FROM {table}" for table in KIND_OF)


def _gels(connection: sqlite3.Connection) -> Iterator[Finding]:
    """A gel has been pressed at least as often as the history says, and as often unless there is a reason."""
    oldest = _count(connection, "SELECT coalesce(min(number), 1) FROM presses")
    rows = connection.execute(
        "SELECT gel_id, serial, presses - coalesce(presses_before, 0), "
        f"(SELECT count(*) FROM ({_EVERY_PRESS}) AS p WHERE p.serial = gels.serial AND p.gel_id = gels.gel_id) "
        "FROM gels ORDER BY serial, gels.rowid"
    )
    for gel_id, serial, counted, recorded in rows:
        where = f"gel {gel_id} of sensor {serial} counts {write_count(counted, 'press')}, the history has {recorded}"
        if counted < recorded:
            yield Finding("gels", f"{where}: the count was lowered")
        elif counted > recorded:
            why = "older ones have left it" if oldest > 1 else "the others were made while it refused writes"
            yield Finding("gels", f"{where}: {why}, or were in a database that was lost", is_fault=False)


def _counts(connection: sqlite3.Connection, counts: dict[str, Count]) -> Iterator[Finding]:
    """The second record of the counts is never ahead of the database."""
    number = _count(connection, "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'presses'")
    for serial, known in counts.items():
        gel = connection.execute(
            "SELECT presses FROM gels WHERE serial = ? AND gel_id = ?", (serial, known.gel_id)
        ).fetchone()
        presses = gel[0] if gel else 0
        if known.presses > presses or known.sequence > number:
            yield Finding(
                "counts",
                f"the second record has {write_count(known.presses, 'press')} of gel {known.gel_id} up to number "
                f"{known.sequence}, "
                f"the database {presses} up to {number}: it was removed, cut or replaced by an old copy; look for "
                "the lost file, or start the gateway, which goes on from the higher count",
            )
        if known.uncounted:
            waiting = write_count(known.uncounted, "press")
            text = f"not yet counted: {waiting} of sensor {serial}; the next start does it"
            yield Finding("counts", text, is_fault=False)


def _outbox(connection: sqlite3.Connection) -> Iterator[Finding]:
    """Its totals are those of its rows, each row can be sent, and each waiting result has its press."""
    totals = connection.execute("SELECT rows, bytes FROM outbox_size").fetchone()
    counted = connection.execute("SELECT count(*), coalesce(sum(bytes), 0) FROM outbox").fetchone()
    if totals != counted:
        mismatch = f"{counted[0]} rows of {counted[1]} bytes, its totals say {totals[0]} and {totals[1]}"
        yield Finding("outbox", f"it has {mismatch}")
    if orphans := _count(
        connection, "SELECT count(*) FROM settled WHERE row_id NOT IN (SELECT row_id FROM outbox)"
    ):
        yield Finding("outbox", f"acknowledgements of rows that are not there: {orphans}")
    faults: dict[str, list[int]] = defaultdict(list)
    oldest = _count(connection, "SELECT coalesce(min(time_ns), 0) FROM presses")  # reads all of them
    rows = "SELECT row_id, topic, content_type, bytes, payload FROM outbox ORDER BY row_id"
    for row_id, *row in connection.execute(rows):
        for what in _row_faults(connection, oldest, *row):
            faults[what].append(row_id)
    for what, ids in faults.items():
        yield Finding("outbox", f"rows that {what}: {len(ids)}; the first is row {ids[0]}")
    if refused := _count(connection, "SELECT count(DISTINCT row_id) FROM settled WHERE refusal IS NOT NULL"):
        yield Finding("outbox", f"rows that a receiver refused, and that wait: {refused}", is_fault=False)


def _row_faults(
    connection: sqlite3.Connection, oldest: int, topic: str, content_type: str, size: int, payload: bytes
) -> Iterator[str]:
    """List what is wrong with a row. oldest: the time of the oldest press."""
    if size != len(payload) + ROW_OVERHEAD_BYTES:
        yield "have another size than they say"
    try:
        content = json.loads(payload) if content_type == "application/json" and payload else {}
    except ValueError:
        content = None
    if not isinstance(content, dict):
        yield "hold a message that is no JSON"
    elif topic == "result" and content:
        press_id = (content.get("press_id"),)
        known = connection.execute("SELECT 1 FROM presses WHERE press_id = ?", press_id).fetchone()
        if known is None and content.get("time_ns", 0) >= oldest:
            yield "are results of presses that the history does not have"


class _Start(NamedTuple):
    """The row of `ledger_start`."""

    one: int
    ledger_id: str
    presses_up_to: int
    acts_up_to: int
    acts_removed_up_to: int
    link: int
    hash: bytes


def _ledger(connection: sqlite3.Connection, held: Head | None) -> Iterator[Finding]:
    """The first row that was changed, removed or inserted, as a fault; where the chain starts, as a note."""
    row = connection.execute("SELECT * FROM ledger_start").fetchone()
    start = _Start(*row) if row else None
    faults = _chain_faults(connection, start) if start else iter([f"{_name('start', 1)} was removed"])
    if (fault := next(faults, None)) is not None:
        yield Finding(
            "ledger",
            f"{fault}; keep the file as it is, compare with a backup, and see who may write it; "
            "the links after it say nothing about the rows before",
        )
    if start is None:
        return
    if start.hash == NO_HASH and start.presses_up_to:
        text = f"the chain starts after press {start.presses_up_to}, where the database was migrated: older rows are"
        yield Finding("ledger", f"{text} not covered", is_fault=False)
    if held is not None:
        yield from _check_head(connection, start, held)


def _chain_faults(connection: sqlite3.Connection, start: _Start) -> Iterator[str]:
    """List the faults in the order of the chain, then the rows that are not in it."""
    newest: dict[tuple[str, int | str], int] = {
        (kind, ref): link
        for kind, ref, link in connection.execute(
            "SELECT kind, ref, max(link) FROM ledger_chain WHERE kind <> 'press' GROUP BY kind, ref"
        )
    }
    if ("start", 1) not in newest:
        yield f"the link of {_name('start', 1)} was removed"
    number, before = start.link, start.hash
    links = connection.execute("SELECT link, kind, ref, content, hash FROM ledger_chain ORDER BY link")
    for link, kind, ref, content, made in links:
        if link != number + 1:
            yield f"links {number + 1} to {link - 1}, before that of {_name(kind, ref)}, were removed"
        if kind not in KINDS or hash_link(before, link, kind, ref, content) != made:
            yield (
                f"link {link}, of {_name(kind, ref)}, does not follow from the one before: it was changed or inserted"
            )
        elif newest.get((kind, ref), link) == link:
            yield from _row_fault(connection, start, kind, ref, content)
        number, before = link, made
    written = _count(
        connection, "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'ledger_chain'"
    )
    if written > number:
        yield f"links {number + 1} to {written}, the newest of the chain, were removed"
    yield from _find_unchained(connection, start)


def _row_fault(
    connection: sqlite3.Connection, start: _Start, kind: str, ref: int | str, content: bytes
) -> Iterator[str]:
    """Compare a row with its newest link. A row may be gone where only the newest are kept."""
    row = read_row(connection, kind, ref)
    if row is not None:
        if hashlib.sha256(canonical(row)).digest() != content:
            yield f"{_name(kind, ref)} was changed after it was written"
        return
    retired_up_to = {"act": start.acts_removed_up_to}
    if kind == "reference":
        newest = _count(connection, "SELECT coalesce(max(number), 0) FROM reference_presses")
        retired_up_to[kind] = newest - KEPT_REFERENCES
    if kind == "piece":
        newest = _count(connection, "SELECT coalesce(max(number), 0) FROM pieces")
        retired_up_to[kind] = newest - KEPT_PIECES
    if not isinstance(ref, int) or ref > retired_up_to.get(kind, ref - 1):
        yield f"{_name(kind, ref)} was removed"


def _find_unchained(connection: sqlite3.Connection, start: _Start) -> Iterator[str]:
    """Find rows without a link: they were inserted."""
    after = {"presses": start.presses_up_to}
    queries = [
        (kind, f"SELECT number FROM {table} WHERE number > {after.get(table, 0)} AND number", "number")
        for table, kind in KIND_OF.items()
    ]
    acts = (
        f"SELECT act_id FROM acts WHERE act_id > {start.acts_up_to} AND outcome IS NOT 'refused' AND act_id"
    )
    pieces = "SELECT number FROM pieces WHERE number"
    gels = "SELECT gel_id || ' of sensor ' || serial FROM gels WHERE json_array(serial, gel_id)"
    for kind, query, order in (
        *queries,
        ("piece", pieces, "number"),
        ("act", acts, "act_id"),
        ("gel", gels, "serial, gel_id"),
    ):
        unchained = (
            f"{query} NOT IN (SELECT ref FROM ledger_chain WHERE kind = '{kind}') ORDER BY {order} LIMIT 1"
        )
        if (row := connection.execute(unchained).fetchone()) is not None:
            yield f"{_name(kind, row[0])} was inserted: it has no link"


def _check_head(connection: sqlite3.Connection, start: _Start, held: Head) -> Iterator[Finding]:
    if held.ledger_id != start.ledger_id:
        yield Finding(
            "ledger",
            f"the head {held} is of ledger {held.ledger_id}, this database is ledger {start.ledger_id}: it is of "
            "another station, or was made again; name the database that published it",
        )
        return
    if held.link < start.link:
        text = f"link {held.link} of the head went with its old presses, so it cannot be compared: keep a newer one"
        yield Finding("ledger", text, is_fault=False)
        return
    row = connection.execute("SELECT hash FROM ledger_chain WHERE link = ?", (held.link,)).fetchone()
    sha256 = row[0] if row else start.hash if held.link == start.link else None
    if sha256 is None or sha256.hex() != held.sha256:
        yield Finding(
            "ledger",
            f"the head {held} is not in the chain: the ledger was written again, or replaced by an old copy; look for "
            "the file that published it",
        )


def _name(kind: str, ref: int | str) -> str:
    if kind == "start":
        return "the row that says where the chain starts"
    return f"{kind}{' press' if kind in ('reference', 'study') else ''} {ref}"
