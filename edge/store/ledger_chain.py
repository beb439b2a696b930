"""The ledger chained by hash: a press, an act or a gel cannot be changed, removed or added afterwards without a trace.

Every row that is written gets a *link*, in the same transaction:

    content = SHA-256 of the row as canonical JSON
    hash    = SHA-256 of (hash of the link before, content, "<link> <kind> <ref>")

The canonical JSON of a row is an object of its columns that are not NULL: UTF-8, keys sorted, no spaces, integers in
digits, text as it is, real numbers as the 16 hexadecimal digits of their IEEE 754 double (big-endian), bytes as
hexadecimal digits. A row that changes in normal work (an act that ends, a gel that is removed) gets a further link: the
newest link of a row is the one that must agree with it. Of a gel, its counters are not part of the content.

The row of `ledger_start` says where the chain starts: at the migration of an older database, or where the history of
presses was cut last. It has a link itself. Refused requests changed nothing and are not chained.

Runs inside the caller's transaction.
"""

import hashlib
import json
import os
import sqlite3
import struct
from dataclasses import dataclass
from typing import Any, Final

__all__ = [
    "KINDS",
    "KIND_OF",
    "Head",
    "append",
    "canonical",
    "cut",
    "hash_link",
    "head",
    "read_row",
    "start",
]

NO_HASH: Final = bytes(32)

_GEL: Final = (
    "serial, gel_id, limit_presses, installed_ns, removed_ns, note, gel_serial, gel_type, use_by, presses_before, "
    "wear_before"
)
KINDS: Final = {
    "press": "SELECT * FROM presses WHERE number = ?",
    "reference": "SELECT * FROM reference_presses WHERE number = ?",
    "study": "SELECT * FROM study_presses WHERE number = ?",
    "piece": "SELECT * FROM pieces WHERE number = ?",
    "act": "SELECT * FROM acts WHERE act_id = ?",
    "gel": f"SELECT {_GEL} FROM gels WHERE json_array(serial, gel_id) = ?",
    "start": "SELECT * FROM ledger_start WHERE one = ?",
}
"""The kind of a row to the query that reads it by its `ref`."""

KIND_OF: Final = {"presses": "press", "reference_presses": "reference", "study_presses": "study"}
"""The table of a press to its kind."""


@dataclass(frozen=True)
class Head:
    """The newest link of a station's ledger. Who keeps it can prove later that the ledger holds everything up to it."""

    ledger_id: str
    """The id of the database, made at random."""
    link: int
    sha256: str
    """The hash in hexadecimal digits."""

    def __str__(self) -> str:
        return f"{self.ledger_id}.{self.link}.{self.sha256}"

    @classmethod
    def parse(cls, text: str) -> "Head":
        """Read a head from text. Errors: ValueError, one sentence."""
        parts = text.strip().split(".")
        if (
            len(parts) != 3
            or not parts[1].isdecimal()
            or not _is_hex(parts[0], 8)
            or not _is_hex(parts[2], 64)
        ):
            raise ValueError(
                f"'{text:.100}' is no head of a ledger; expected <8 hexadecimal digits>.<link>.<64 of them>, as in the "
                "field ledger_head of `result` and `stats`"
            )
        return cls(parts[0], int(parts[1]), parts[2])


def append(connection: sqlite3.Connection, kind: str, ref: int | str) -> Head:
    """Chain this row as it is now. Errors: LookupError for a row that is not there."""
    row = read_row(connection, kind, ref)
    if row is None:
        raise LookupError(f"no {kind} {ref} is there to be chained")
    ledger_id, number, before = _newest(connection)
    content = hashlib.sha256(canonical(row)).digest()
    made = hash_link(before, number + 1, kind, ref, content)
    connection.execute(
        "INSERT INTO ledger_chain VALUES (?, ?, ?, ?, ?)", (number + 1, kind, ref, content, made)
    )
    return Head(ledger_id, number + 1, made.hex())


def append_gels(connection: sqlite3.Connection, serial: str) -> None:
    """Chain the gels of this sensor that differ from their newest link."""
    gels = connection.execute(
        "SELECT json_array(serial, gel_id) FROM gels WHERE serial = ? ORDER BY installed_ns", (serial,)
    ).fetchall()
    for (ref,) in gels:
        row = read_row(connection, "gel", ref)
        known = connection.execute(
            "SELECT content FROM ledger_chain WHERE kind = 'gel' AND ref = ? ORDER BY link DESC LIMIT 1",
            (ref,),
        ).fetchone()
        if row is not None and (known is None or known[0] != hashlib.sha256(canonical(row)).digest()):
            append(connection, "gel", ref)


def head(connection: sqlite3.Connection) -> Head:
    """The newest link."""
    ledger_id, number, made = _newest(connection)
    return Head(ledger_id, number, made.hex())


def start(connection: sqlite3.Connection) -> None:
    """Begin the chain, unless it was begun: presses of parts and acts that are there already stay outside."""
    if connection.execute("SELECT 1 FROM ledger_start").fetchone() is not None:
        return
    connection.execute(
        "INSERT INTO ledger_start SELECT 1, ?, (SELECT coalesce(max(number), 0) FROM presses), "
        "(SELECT coalesce(max(act_id), 0) FROM acts), 0, 0, ?",
        (os.urandom(4).hex(), NO_HASH),
    )
    append(connection, "start", 1)
    for (serial,) in connection.execute("SELECT DISTINCT serial FROM gels ORDER BY serial").fetchall():
        append_gels(connection, serial)
    for table in ("reference_presses", "study_presses"):
        for (number,) in connection.execute(f"SELECT number FROM {table} ORDER BY number").fetchall():
            append(connection, KIND_OF[table], number)


def cut(connection: sqlite3.Connection, presses_up_to: int) -> None:
    """The history has lost its presses up to this number: the links up to theirs go as well, and the chain starts with
    the next one, anchored by the hash of the last that went. What is kept for longer gets a new link."""
    kept = connection.execute(
        "SELECT link FROM ledger_chain WHERE kind = 'press' AND ref > ? ORDER BY link LIMIT 1",
        (presses_up_to,),
    ).fetchone()
    last = connection.execute(
        "SELECT link, hash FROM ledger_chain WHERE link = ?", (kept[0] - 1 if kept else 0,)
    ).fetchone()
    if last is None:  # nothing before it is chained
        connection.execute("UPDATE ledger_start SET presses_up_to = max(presses_up_to, ?)", (presses_up_to,))
    else:
        gone = connection.execute(
            "SELECT DISTINCT kind, ref FROM ledger_chain WHERE link <= ? AND kind NOT IN ('press', 'start') "
            "ORDER BY link",
            (last[0],),
        ).fetchall()
        acts = max((ref for kind, ref in gone if kind == "act"), default=0)
        connection.execute("DELETE FROM ledger_chain WHERE link <= ?", (last[0],))
        connection.execute(
            "UPDATE ledger_start SET presses_up_to = max(presses_up_to, ?), acts_up_to = max(acts_up_to, ?), "
            "link = ?, hash = ?",
            (presses_up_to, acts, *last),
        )
        for kind, ref in gone:
            if kind != "act" and read_row(connection, kind, ref) is not None:
                append(connection, kind, ref)
    append(connection, "start", 1)


def note_removed_acts(connection: sqlite3.Connection, up_to: int) -> None:
    """Note that acts up to this id were removed; their links stay until the history of presses is cut."""
    connection.execute("UPDATE ledger_start SET acts_removed_up_to = max(acts_removed_up_to, ?)", (up_to,))
    append(connection, "start", 1)


def hash_link(before: bytes, link: int, kind: str, ref: int | str, content: bytes) -> bytes:
    """Hash a link."""
    return hashlib.sha256(before + content + f"{link} {kind} {ref}".encode()).digest()


def read_row(connection: sqlite3.Connection, kind: str, ref: int | str) -> dict[str, Any] | None:
    """Read the columns of a chained row; None where it is not there."""
    cursor = connection.execute(KINDS[kind], (ref,))
    row = cursor.fetchone()
    return None if row is None else dict(zip((column[0] for column in cursor.description), row, strict=True))


def canonical(row: dict[str, Any]) -> bytes:
    """The one serialisation of a row that its hash is of."""
    plain = {name: _plain(value) for name, value in row.items() if value is not None}
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode(
        errors="replace"
    )


def _plain(value: object) -> object:
    if isinstance(value, float):
        return struct.pack(">d", value).hex()
    return value.hex() if isinstance(value, bytes) else value


def _newest(connection: sqlite3.Connection) -> tuple[str, int, bytes]:
    """(ledger id, number, hash) of the newest link, or of the one that the chain starts after."""
    ledger_id, number, made = connection.execute(
        "SELECT ledger_id, coalesce(newest.link, begun.link), coalesce(newest.hash, begun.hash) FROM ledger_start "
        "AS begun LEFT JOIN (SELECT link, hash FROM ledger_chain ORDER BY link DESC LIMIT 1) AS newest"
    ).fetchone()
    return ledger_id, number, made


def _is_hex(text: str, digits: int) -> bool:
    return len(text) == digits and not set(text) - set("0123456789abcdef")
