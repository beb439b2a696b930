"""Whether the ledger still holds what was written: every link follows from the one before, every row agrees with its
newest link, and no chained row is missing or was added. See `edge.store.ledger_chain`.
"""

import hashlib
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from edge.store.ledger_chain import KIND_OF, KINDS, NO_HASH, Head, Link, canonical, hash_link, read_row
from edge.store.reference_presses import KEPT_REFERENCES

__all__ = ["Finding", "chain_findings"]

PART: Final = "ledger"
ADVICE: Final = (
    "keep the file as it is, compare with a backup, and see who may write it; "
    "the links after it say nothing about the rows before"
)

_WORDS: Final = {
    "reference": "reference press",
    "study": "study press",
    "press": "press",
    "act": "act",
    "gel": "gel",
}


@dataclass(frozen=True)
class Finding:
    """One sentence about one part: file, presses, gels, counts, outbox or ledger."""

    part: str
    text: str
    is_fault: bool = True


@dataclass(frozen=True)
class _Start:
    """The row of `ledger_start`."""

    one: int
    ledger_id: str
    presses_up_to: int
    acts_up_to: int
    acts_removed_up_to: int
    link: int
    hash: bytes


def chain_findings(connection: sqlite3.Connection, held: Head | None = None) -> Iterator[Finding]:
    """The first row that was changed, removed or inserted, as a fault; where the chain starts, as a note.

    held: a head that was published earlier and must be in the chain.
    """
    row = connection.execute("SELECT * FROM ledger_start").fetchone()
    if row is None:
        yield Finding(PART, f"the row that says where the chain starts was removed; {ADVICE}")
        return
    start = _Start(*row)
    fault = next(_faults(connection, start), None)
    if fault is not None:
        yield Finding(PART, f"{fault}; {ADVICE}")
    yield from _notes(start)
    if held is not None:
        yield from _check_head(connection, start, held)


def _faults(connection: sqlite3.Connection, start: _Start) -> Iterator[str]:
    """List the faults in the order of the chain, then the rows that are not in it."""
    newest: dict[tuple[str, int | str], int] = {
        (kind, ref): link
        for kind, ref, link in connection.execute(
            "SELECT kind, ref, max(link) FROM ledger_chain WHERE kind <> 'press' GROUP BY kind, ref"
        )
    }
    if ("start", 1) not in newest:
        yield "the link of the row that says where the chain starts was removed"
    number, before = start.link, start.hash
    for row in connection.execute("SELECT link, kind, ref, content, hash FROM ledger_chain ORDER BY link"):
        link = Link(*row)
        yield from _of_link(connection, start, link, number, before, newest)
        number, before = link.link, link.hash
    (written,) = connection.execute(
        "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'ledger_chain'"
    ).fetchone()
    if written > number:
        yield f"links {number + 1} to {written}, the newest of the chain, were removed"
    yield from _find_unchained(connection, start)


def _of_link(
    connection: sqlite3.Connection,
    start: _Start,
    link: Link,
    number: int,
    before: bytes,
    newest: dict[tuple[str, int | str], int],
) -> Iterator[str]:
    if link.link != number + 1:
        yield f"links {number + 1} to {link.link - 1}, before that of {_describe(link)}, were removed"
    if link.kind not in KINDS or hash_link(before, link.link, link.kind, link.ref, link.content) != link.hash:
        yield f"link {link.link}, of {_describe(link)}, does not follow from the one before: it was changed or inserted"
        return
    if newest.get((link.kind, link.ref), link.link) != link.link:
        return
    row = read_row(connection, link.kind, link.ref)
    if row is None and not _is_retired(connection, start, link):
        yield f"{_describe(link)} was removed"
    elif row is not None and hashlib.sha256(canonical(row)).digest() != link.content:
        yield f"{_describe(link)} was changed after it was written"


def _is_retired(connection: sqlite3.Connection, start: _Start, link: Link) -> bool:
    """Tell whether the row went because only the newest are kept."""
    if not isinstance(link.ref, int):
        return False
    if link.kind == "reference":
        (newest,) = connection.execute("SELECT coalesce(max(number), 0) FROM reference_presses").fetchone()
        return link.ref <= int(newest) - KEPT_REFERENCES
    return link.kind == "act" and link.ref <= start.acts_removed_up_to


def _find_unchained(connection: sqlite3.Connection, start: _Start) -> Iterator[str]:
    """Find rows without a link: they were inserted."""
    for table, kind in KIND_OF.items():
        press = connection.execute(
            f"SELECT number FROM {table} WHERE number > ? AND number NOT IN "
            "(SELECT ref FROM ledger_chain WHERE kind = ?) ORDER BY number LIMIT 1",
            (start.presses_up_to if kind == "press" else 0, kind),
        ).fetchone()
        if press is not None:
            yield f"{_WORDS[kind]} {press[0]} was inserted: it has no link"
    act = connection.execute(
        "SELECT act_id FROM acts WHERE act_id > ? AND outcome IS NOT 'refused' AND act_id NOT IN "
        "(SELECT ref FROM ledger_chain WHERE kind = 'act') ORDER BY act_id LIMIT 1",
        (start.acts_up_to,),
    ).fetchone()
    if act is not None:
        yield f"act {act[0]} was inserted: it has no link"
    gel = connection.execute(
        "SELECT gel_id, serial FROM gels WHERE json_array(serial, gel_id) NOT IN "
        "(SELECT ref FROM ledger_chain WHERE kind = 'gel') ORDER BY serial, gel_id LIMIT 1"
    ).fetchone()
    if gel is not None:
        yield f"gel {gel[0]} of sensor {gel[1]} was inserted: it has no link"


def _notes(start: _Start) -> Iterator[Finding]:
    if start.hash == NO_HASH and start.presses_up_to:
        yield Finding(
            PART,
            f"the chain starts after press {start.presses_up_to}, where the database was migrated: older rows are not "
            "covered",
            is_fault=False,
        )


def _check_head(connection: sqlite3.Connection, start: _Start, held: Head) -> Iterator[Finding]:
    if held.ledger_id != start.ledger_id:
        yield Finding(
            PART,
            f"the head {held} is of ledger {held.ledger_id}, this database is ledger {start.ledger_id}: it is of "
            "another station, or was made again; name the database that published it",
        )
        return
    if held.link < start.link:
        yield Finding(
            PART,
            f"link {held.link} of the head went with its old presses, so it cannot be compared: keep a newer one",
            is_fault=False,
        )
        return
    row = connection.execute("SELECT hash FROM ledger_chain WHERE link = ?", (held.link,)).fetchone()
    sha256 = row[0] if row else start.hash if held.link == start.link else None
    if sha256 is None or sha256.hex() != held.sha256:
        yield Finding(
            PART,
            f"the head {held} is not in the chain: the ledger was written again, or replaced by an old copy; look for "
            "the file that published it",
        )


def _describe(link: Link) -> str:
    if link.kind == "start":
        return "the row that says where the chain starts"
    return f"{_WORDS.get(link.kind, link.kind)} {link.ref}"
