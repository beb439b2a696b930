"""The outbox: messages that wait for the acknowledgement of every sink, limited in bytes and age.

The transaction that records a press adds rows (`put`, `enforce`); the publisher removes them through its own `Outbox`.
A retained message replaces an older one that still waits on its topic, and rows leave in order: a retained topic never
returns to an older value. A row is deleted when all sinks acknowledged it, or by the limits: pictures first, passes
next, everything else last, oldest first, each counted.
"""

import sqlite3
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Final, Self

from edge.core.ports import Message
from edge.store.database import Database, insert

__all__ = [
    "Bounds",
    "DropPriority",
    "Outbox",
    "OutboxRow",
    "OutboxStatus",
    "drop_priority_of",
    "enforce",
    "forget",
    "owe_picture",
    "owed_pictures",
    "put",
    "put_picture",
]

# What a row costs besides its payload: columns, three indexes, page slack. Measured on 4 KiB pages: 150 to 250 bytes.
ROW_OVERHEAD_BYTES: Final = 256


Make = Callable[[bool], Iterable[Message]]
"""Makes messages of a press, from whether it is the newest one of a part."""
Measured = Mapping[str, float | None] | None
"""Columns of a press that are known only when its picture is drawn."""


class DropPriority(IntEnum):
    """What is dropped first when there is no room; column `worth` of the tables.

    RETAINED is never dropped: there is at most one row per topic.
    """

    HEATMAP = 0
    PASS = 1
    FAIL = 2
    RETAINED = 3


@dataclass(frozen=True)
class Bounds:
    """How much may wait."""

    max_bytes: int = 512 << 20
    """Payloads and their rows."""
    max_age_s: float = 30 * 86400.0
    """The longest running time of a message (edge.store.database)."""

    def __post_init__(self) -> None:
        if self.max_bytes < 1 or not self.max_age_s > 0:
            raise ValueError(
                f"outbox bounds are positive, found {self.max_bytes} bytes and {self.max_age_s} s"
            )


@dataclass(frozen=True)
class OutboxRow:
    """A waiting message. `row_id` rises with every row and is never used again."""

    row_id: int
    message: Message


@dataclass(frozen=True)
class OutboxStatus:
    """rows, bytes: waiting now. refused: rows that a sink refused and that are kept. dropped: the number of `heatmap`,
    `pass` and `fail` rows dropped since the database was made. unseen: those of them that nobody has acknowledged;
    aged: those of the unseen that were dropped for their age."""

    rows: int
    bytes: int
    refused: int
    dropped: Mapping[str, int]
    unseen: Mapping[str, int] = field(default_factory=dict)
    aged: Mapping[str, int] = field(default_factory=dict)


def drop_priority_of(message: Message, verdict: str) -> DropPriority:
    """A retained message is kept, a picture is dropped first, a pass before the rest."""
    if message.retain:
        return DropPriority.RETAINED
    if message.content_type.startswith("image/"):
        return DropPriority.HEATMAP
    return DropPriority.PASS if verdict == "pass" else DropPriority.FAIL


def put(
    connection: sqlite3.Connection, messages: Iterable[Message], verdict: str, time_ns: int, running_ns: int
) -> None:
    """Add messages, in order, inside the caller's transaction. time_ns: wall clock, for people alone."""
    for message in messages:
        if message.retain:
            forget(connection, message.topic)
        names = ("topic", "qos", "content_type", "expiry_s", "payload")
        row = {
            **{name: getattr(message, name) for name in names},
            "created_ns": time_ns,
            "running_ns": running_ns,
            "retain": int(message.retain),
            "worth": drop_priority_of(message, verdict),
            "bytes": len(message.payload) + ROW_OVERHEAD_BYTES,
        }
        insert(connection, "outbox", row)


def forget(connection: sqlite3.Connection, topic: str) -> None:
    """Forget the message that waits on a retained topic, inside the caller's transaction."""
    connection.execute("DELETE FROM outbox WHERE topic = ? AND retain = 1", (topic,))


def owe_picture(connection: sqlite3.Connection, press_id: str, verdict: str, time_ns: int) -> None:
    """Note that the picture of a press follows its other messages, inside their transaction."""
    connection.execute("INSERT INTO owed_pictures VALUES (?, ?, ?)", (press_id, verdict, time_ns))


def owed_pictures(connection: sqlite3.Connection) -> list[str]:
    """The presses whose picture is owed, oldest first."""
    return [press_id for (press_id,) in connection.execute("SELECT press_id FROM owed_pictures ORDER BY 1")]


def put_picture(
    connection: sqlite3.Connection,
    press_id: str,
    make_messages: Make,
    running_ns: int,
    measured: Measured,
) -> None:
    """Add the picture of a press where it is owed. measured: written into the press."""
    owed = "FROM owed_pictures WHERE press_id = ?"
    row = connection.execute(f"SELECT verdict, time_ns {owed}", (press_id,)).fetchone()
    if row is None:
        return
    newest = connection.execute("SELECT press_id FROM presses ORDER BY number DESC LIMIT 1").fetchone()
    put(connection, make_messages(newest == (press_id,)), row[0], row[1], running_ns)
    connection.execute(f"DELETE {owed}", (press_id,))
    if measured:
        columns = ", ".join(f"{name} = ?" for name in measured)
        connection.execute(f"UPDATE presses SET {columns} WHERE press_id = ?", (*measured.values(), press_id))


def enforce(connection: sqlite3.Connection, bounds: Bounds, running_ns: int) -> None:
    """Drop what is too old, then what does not fit, inside the caller's transaction. running_ns: now."""
    oldest_allowed = running_ns - int(bounds.max_age_s * 1e9)
    aged = connection.execute(
        "SELECT row_id, worth, bytes FROM outbox WHERE running_ns < ? AND worth < ?",
        (oldest_allowed, DropPriority.RETAINED),
    ).fetchall()
    _drop(connection, aged)
    _count_drops(connection, "dropped_by_age", aged)
    size = "SELECT bytes FROM outbox_size"
    while (excess := connection.execute(size).fetchone()[0] - bounds.max_bytes) > 0:
        victims = connection.execute(
            "SELECT row_id, worth, bytes FROM outbox WHERE worth < ? ORDER BY worth, row_id LIMIT 64",
            (DropPriority.RETAINED,),
        ).fetchall()
        if not victims:
            return
        _drop(connection, _enough(victims, excess))


def _enough(victims: Sequence[tuple[int, int, int]], excess: int) -> list[tuple[int, int, int]]:
    chosen: list[tuple[int, int, int]] = []
    for victim in victims:
        if excess <= 0:
            break
        chosen.append(victim)
        excess -= victim[2]
    return chosen


def _drop(connection: sqlite3.Connection, victims: Sequence[tuple[int, int, int]]) -> None:
    connection.executemany("DELETE FROM outbox WHERE row_id = ?", [(row_id,) for row_id, _, _ in victims])
    _count_drops(connection, "dropped", victims)


def _count_drops(connection: sqlite3.Connection, table: str, victims: Iterable[tuple[int, int, int]]) -> None:
    connection.executemany(
        f"INSERT INTO {table} (worth, rows, bytes) VALUES (?, 1, ?) "
        "ON CONFLICT (worth) DO UPDATE SET rows = rows + 1, bytes = bytes + excluded.bytes",
        [(priority, size) for _, priority, size in victims],
    )


class Outbox:
    """The publisher's side, with its own connection. Any thread may use it, one at a time.

    Its commits survive a crash, but perhaps not a power cut: an acknowledged row is then sent again.
    """

    def __init__(self, path: Path) -> None:
        self._database = Database(path, is_durable=False)

    def register(self, sinks: Iterable[str], before: Mapping[str, str] | None = None) -> None:
        """Name the sinks that must acknowledge a row, from now on, before it leaves.

        sinks: names that belong to a receiver, whatever its place in the configuration. before: names of version 0.2
        and earlier to present ones. What an absent sink has acknowledged is remembered: it may come back.
        """
        names = sorted(set(sinks))
        with self._database.writing("registering sinks") as connection:
            _rename(connection, before or {})
            connection.execute("DELETE FROM sinks")
            connection.executemany("INSERT INTO sinks VALUES (?)", [(name,) for name in names])
            if names:
                connection.execute(
                    "DELETE FROM outbox WHERE NOT EXISTS (SELECT 1 FROM sinks WHERE name NOT IN "
                    "(SELECT sink FROM settled WHERE settled.row_id = outbox.row_id AND refusal IS NULL))"
                )

    def pending(self, sink: str, limit: int = 16, after: int = 0) -> list[OutboxRow]:
        """The oldest rows after row `after` that this sink has not acknowledged or refused, in order."""
        with self._database.reading("reading the outbox") as connection:
            rows = connection.execute(
                "SELECT row_id, topic, payload, qos, retain, content_type, expiry_s FROM outbox "
                "WHERE row_id > ? AND NOT EXISTS "
                "(SELECT 1 FROM settled WHERE settled.row_id = outbox.row_id AND sink = ?) ORDER BY row_id LIMIT ?",
                (after, sink, limit),
            ).fetchall()
        return [
            OutboxRow(row_id, Message(topic, payload, qos, bool(retain), content_type, expiry))
            for row_id, topic, payload, qos, retain, content_type, expiry in rows
        ]

    def acknowledge(self, row_ids: Iterable[int], sink: str) -> None:
        """This sink has these rows; each leaves the outbox when all sinks have it. Harmless when repeated."""
        with self._database.writing("acknowledging") as connection:
            for row_id in row_ids:
                self._settle(connection, row_id, sink, None)
                connection.execute(
                    "DELETE FROM outbox WHERE row_id = ? AND NOT EXISTS (SELECT 1 FROM sinks WHERE name NOT IN "
                    "(SELECT sink FROM settled WHERE row_id = ? AND refusal IS NULL))",
                    (row_id, row_id),
                )

    def refuse(self, row_id: int, sink: str, why: str) -> None:
        """This sink refuses the row: it is kept and not sent until `offer_refused`, or dropped by the limits."""
        with self._database.writing("noting a refusal") as connection:
            self._settle(connection, row_id, sink, why)

    def offer_refused(
        self, sink: str, limit: int | None = None, after: int = 0, kind: str | None = None
    ) -> list[int]:
        """Queue rows that this sink refused again; returns their ids, oldest first.

        limit: at most this number; None for all. after: only rows after this one. kind: only topics with this first
        level; None for all.
        """
        with self._database.writing("offering refused rows again") as connection:
            rows = connection.execute(
                "SELECT row_id FROM settled JOIN outbox USING (row_id) WHERE sink = ? AND refusal IS NOT NULL "
                "AND row_id > ? AND (? IS NULL OR topic = ? OR topic LIKE ? || '/%') ORDER BY row_id LIMIT ?",
                (sink, after, kind, kind, kind, -1 if limit is None else limit),
            ).fetchall()
            return self._queue_again(connection, sink, rows)

    def offer_first_of_kinds(self, sink: str) -> list[int]:
        """Queue again the oldest row of each kind that this sink refused; returns their ids."""
        # It reads every refused row, so it is no transaction that a press would wait for.
        with self._database.reading("reading the refused rows") as connection:
            rows = connection.execute(
                "SELECT min(row_id) FROM settled JOIN outbox USING (row_id) WHERE sink = ? AND refusal IS NOT NULL "
                "GROUP BY substr(topic, 1, instr(topic || '/', '/') - 1) ORDER BY 1",
                (sink,),
            ).fetchall()
        if not rows:
            return []
        with self._database.writing("offering refused rows again") as connection:
            return self._queue_again(connection, sink, rows)

    def newest(self) -> int:
        """The id of the newest row that was ever added, 0 before the first."""
        with self._database.reading("reading the outbox") as connection:
            row = connection.execute("SELECT seq FROM sqlite_sequence WHERE name = 'outbox'").fetchone()
        return 0 if row is None else int(row[0])

    def status(self) -> OutboxStatus:
        with self._database.reading("reading the outbox") as connection:
            rows, size = connection.execute("SELECT rows, bytes FROM outbox_size").fetchone()
            refused = connection.execute(
                "SELECT count(DISTINCT row_id) FROM settled WHERE refusal IS NOT NULL"
            ).fetchone()[0]
            dropped = connection.execute("SELECT worth, rows FROM dropped").fetchall()
            unseen = connection.execute("SELECT worth, rows - acknowledged FROM dropped").fetchall()
            aged = connection.execute("SELECT worth, rows - acknowledged FROM dropped_by_age").fetchall()
        return OutboxStatus(rows, size, refused, _by_name(dropped), _by_name(unseen), _by_name(aged))

    def acknowledge_drops(self, status: OutboxStatus) -> None:
        """A person has seen the drops that this status has; those after it stay unseen."""
        with self._database.writing("acknowledging drops") as connection:
            for table, counts in (("dropped", status.unseen), ("dropped_by_age", status.aged)):
                connection.executemany(
                    f"UPDATE {table} SET acknowledged = acknowledged + ? WHERE worth = ?",
                    [(number, DropPriority[name.upper()]) for name, number in counts.items()],
                )

    def close(self) -> None:
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @staticmethod
    def _queue_again(connection: sqlite3.Connection, sink: str, rows: Sequence[tuple[int]]) -> list[int]:
        row_ids = [row_id for (row_id,) in rows]
        connection.executemany(
            "DELETE FROM settled WHERE row_id = ? AND sink = ?", [(row_id, sink) for row_id in row_ids]
        )
        return row_ids

    @staticmethod
    def _settle(connection: sqlite3.Connection, row_id: int, sink: str, refusal: str | None) -> None:
        connection.execute(
            "INSERT OR REPLACE INTO settled SELECT row_id, ?, ? FROM outbox WHERE row_id = ?",
            (sink, refusal, row_id),
        )


def _by_name(counts: Iterable[tuple[int, int]]) -> dict[str, int]:
    known = dict(counts)
    kinds = (DropPriority.HEATMAP, DropPriority.PASS, DropPriority.FAIL)
    return {kind.name.lower(): known.get(kind, 0) for kind in kinds}


def _rename(connection: sqlite3.Connection, before: Mapping[str, str]) -> None:
    """Sinks were once named by their place in the configuration, such as `mqtt` and `mqtt-2`.

    Where a plugin had several it is not known which was which: then nothing is renamed, and rows are sent again.
    """
    for old, new in before.items():
        several = connection.execute("SELECT 1 FROM sinks WHERE name = ?", (f"{old}-2",)).fetchone()
        if several is None:
            connection.execute("UPDATE OR IGNORE settled SET sink = ? WHERE sink = ?", (new, old))
