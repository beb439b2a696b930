"""The store: a press is one transaction, so that its verdict, count and messages are all stored or none of them.

One SQLite file holds the presses, the gel ledger and the outbox. The gateway writes through a `Store`; the publisher
reads and acknowledges through an `Outbox` on the same file. Functions that take a connection run inside the caller's
transaction.
"""

import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol, Self, TypeVar

from edge.core.digital_io import VERDICTS
from edge.core.errors import StoreError
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES, DEFAULT_WARN_FRACTION, NO_LABEL, GelLabel
from edge.core.part_position import PartPosition
from edge.core.ports import Message
from edge.store import acts as act_table
from edge.store import bundles_in_use, ledger_chain, outbox
from edge.store import gel_ledger as ledger
from edge.store.database import Database, RunningTime, insert
from edge.store.gel_ledger import GelRecord
from edge.store.ledger_chain import KIND_OF
from edge.store.outbox import Bounds
from edge.store.press_counts import Count, PressCounts, list_corrections, recover
from edge.store.ulid import is_ulid

__all__ = [
    "KEPT_PRESSES",
    "VERDICTS",
    "GelRecord",
    "MakeMessages",
    "PressRecord",
    "PressTable",
    "Recorded",
    "Store",
]

T = TypeVar("T")


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
    shadow: str | None = None
    """What the shadow says of it (`ShadowVerdict.encode`); None without one."""
    piece_id: str | None = None
    """The piece of several places that it is of."""

    def __post_init__(self) -> None:
        if not is_ulid(self.press_id):
            raise ValueError(f"a press id is a ULID, found {self.press_id!r}")
        if self.verdict not in VERDICTS:
            raise ValueError(f"a recorded verdict is one of {', '.join(VERDICTS)}, found {self.verdict!r}")
        if not self.serial or not self.part:
            raise ValueError(f"a press has a sensor and a part, found {self.serial!r} and {self.part!r}")


# Rows of the press history: 350 bytes each with their links, so 350 MB. The ledger's counts do not need them.
KEPT_PRESSES: Final = 1_000_000


class History:
    """The history of parts."""

    name = "presses"

    def insert(
        self, connection: sqlite3.Connection, press: PressRecord, gel: GelRecord, running_ns: int
    ) -> int:
        """Add the press to the history and return its number, which SQLite's AUTOINCREMENT never uses twice."""
        row = {**vars(press), "gel_id": gel.gel_id, "running_ns": running_ns, "gel_presses": gel.presses}
        return insert(connection, "presses", {name: row[name] for name in row if name != "wear_index"})


def find_number(connection: sqlite3.Connection, table: str, press: PressRecord) -> int | None:
    """Find the number of a press that is recorded already. Errors: StoreError when the id is another press's."""
    query = f"SELECT number, serial, time_ns, verdict, score FROM {table} WHERE press_id = ?"
    row = connection.execute(query, (press.press_id,)).fetchone()
    if row is None:
        return None
    if row[1:] != (press.serial, press.time_ns, press.verdict, press.score):
        raise StoreError(f"press id {press.press_id} was already given to another press")
    return int(row[0])


def cut_history(connection: sqlite3.Connection) -> None:
    """Keep the newest presses, and up to a thousandth more, so that they go in groups."""
    ends = (f"SELECT {end}(number) FROM presses" for end in ("min", "max"))  # one query would read every row
    first, last = (connection.execute(end).fetchone()[0] for end in ends)
    if first is None or last - first < KEPT_PRESSES + KEPT_PRESSES // 1000:
        return
    connection.execute("DELETE FROM presses WHERE number <= ?", (last - KEPT_PRESSES,))
    ledger_chain.cut(connection, last - KEPT_PRESSES)


@dataclass(frozen=True)
class Recorded:
    """A press's place in the database."""

    gel: GelRecord
    """The record of its gel, this press included."""
    sequence: int
    """Counts the presses of this database from 1. No restart and no change of gel or sensor resets it, so a missing
    number tells a subscriber that a press was missed."""
    head: ledger_chain.Head
    """The newest link of the ledger."""


class PressTable(Protocol):
    """Where presses of one kind are kept; `number`, `press_id`, `serial`, `time_ns`, `verdict`, `score` it has."""

    @property
    def name(self) -> str: ...

    def insert(
        self, connection: sqlite3.Connection, press: "PressRecord", gel: GelRecord, running_ns: int
    ) -> int:
        """Add it inside the caller's transaction, and return its number, which is never used twice."""


MakeMessages = Callable[[Recorded], Sequence[Message]]
"""From a press's place to its messages. Called inside the transaction: quick and pure."""


class Store:
    """The gateway's side of the database. Any thread may use it, one at a time.

    bounds: of the outbox. limit_presses, warn_fraction: limit of a gel that is not registered, warning of every gel.
    monotonic_ns: by which messages age. Errors of every method: StoreError; earlier commits stay.
    """

    def __init__(
        self,
        path: Path,
        bounds: Bounds | None = None,
        limit_presses: int = DEFAULT_LIMIT_PRESSES,
        warn_fraction: float = DEFAULT_WARN_FRACTION,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._running = RunningTime(monotonic_ns)
        self._bounds = bounds or Bounds()
        self._limit_presses = limit_presses
        self._warn_fraction = warn_fraction
        self._counts = PressCounts(path)
        self._compared: set[str] = set()
        self._newest = 0  # the number of the newest press, as of the last change
        self._database = Database(path)

    @property
    def path(self) -> Path:
        return self._database.path

    def record_press(
        self,
        press: PressRecord,
        make_messages: MakeMessages,
        into: PressTable | None = None,
        write: Callable[[sqlite3.Connection], None] = lambda connection: None,
        *,
        owes_picture: bool = False,
    ) -> Recorded:
        """Number the press, count it and queue its messages, all or nothing; `keep_count` follows.

        into: its table; by default the history of parts. write: what else is written with it. owes_picture:
        `queue_picture` follows. Recording the same press again changes nothing and returns its number and the gel as it
        is now, so a caller may repeat after an error. Errors: StoreError, also when the id belongs to another press;
        any error of `make_messages` and `write`, and then nothing is recorded.
        """
        self._compare(press.serial, press.time_ns)
        table = into or History()
        with self._database.writing(f"recording press {press.press_id}") as connection:
            known = find_number(connection, table.name, press)
            if known is not None:
                gel = self._require_mounted(connection, press.serial)
                return Recorded(gel, known, ledger_chain.head(connection))
            gel = self._count(connection, press)
            running_ns = self._running.store(connection)
            number = table.insert(connection, press, gel, running_ns)
            recorded = Recorded(gel, number, ledger_chain.append(connection, KIND_OF[table.name], number))
            cut_history(connection)
            outbox.put(connection, make_messages(recorded), press.verdict, press.time_ns, running_ns)
            write(connection)
            outbox.enforce(connection, self._bounds, running_ns)
            if owes_picture:
                outbox.owe_picture(connection, press.press_id, press.verdict, press.time_ns)
            self._newest = number if into is None else _newest_number(connection)
        return recorded

    def owed_pictures(self) -> list[str]:
        """The ids of recorded presses whose picture is not queued, oldest first."""
        return self.read("reading the owed pictures", outbox.owed_pictures)

    def queue_picture(self, press_id: str, make: outbox.Make, measured: outbox.Measured) -> None:
        """Queue what is owed of a press, as `put_picture` says; without effect where nothing is."""
        with self._database.writing(f"queueing the picture of press {press_id}") as connection:
            running_ns = self._running.store(connection)
            outbox.put_picture(connection, press_id, make, running_ns, measured)
            outbox.enforce(connection, self._bounds, running_ns)

    def read(self, doing: str, query: Callable[[sqlite3.Connection], T]) -> T:
        """The result of a query of one of the other tables."""
        with self._database.reading(doing) as connection:
            return query(connection)

    def write(self, doing: str, change: Callable[[sqlite3.Connection], T]) -> T:
        """The result of a change of one of the other tables, in a transaction of its own."""
        with self._database.writing(doing) as connection:
            return change(connection)

    def findings(self) -> list[str]:
        """What the second record of the counts has corrected, one sentence each, until a person acknowledges it."""
        return self.read("reading corrected counts", list_corrections)

    def ledger_head(self) -> ledger_chain.Head:
        """The newest link of the ledger: who keeps it can prove later that nothing before it was changed."""
        return self.read("reading the head of the ledger", ledger_chain.head)

    def gel(self, serial: str, time_ns: int) -> GelRecord:
        """The gel mounted on this sensor; an unknown sensor gets its first gel."""
        self._compare(serial, time_ns)
        with self._database.writing(f"reading the gel of sensor {serial}") as connection:
            self._mount_first(connection, serial, time_ns)
            self._running.store_sometimes(connection)
            gel, self._newest = self._require_mounted(connection, serial), _newest_number(connection)
        known = self._counts.read().get(serial)
        if known is None or (known.gel_id, known.presses) != (gel.gel_id, gel.presses):
            self.keep_count(gel)
        return gel

    def gels(self) -> list[GelRecord]:
        """Every gel, by its sensor, oldest first; a mounted one has no `removed_ns`."""
        return self.read("reading the gel ledger", lambda c: ledger.history(c, None, self._warn_fraction))

    def replace_gel(
        self,
        serial: str,
        time_ns: int,
        gel_id: str | None = None,
        limit_presses: int | None = None,
        note: str = "",
        make_messages: Callable[[GelRecord], Sequence[Message]] | None = None,
        act: act_table.Act | None = None,
        label: GelLabel = NO_LABEL,
    ) -> GelRecord:
        """Record that another gel was mounted, as `gel_ledger.mount` does; act: recorded with it, both or neither.
        Errors: StoreError for an id that this sensor already had, and for a gel that is on another sensor."""
        self._compare(serial, time_ns)
        with self._database.writing(f"replacing the gel of sensor {serial}") as connection:
            gels = ledger.history(connection, serial, self._warn_fraction)  # an impossible count too
            before = next((gel for gel in gels if gel.removed_ns is None), None)
            ledger.mount(connection, serial, gel_id, limit_presses, self._limit_presses, note, time_ns, label)
            gel, self._newest = self._require_mounted(connection, serial), _newest_number(connection)
            if act is not None:
                act = replace(act, before=before.facts if before else None, after=gel.facts)
                act_table.begin(connection, act, self._running.store(connection))
            if make_messages is not None:
                outbox.put(connection, make_messages(gel), "", time_ns, self._running.store(connection))
        self.keep_count(gel)
        return gel

    def count_presses(self, serial: str, presses: int, time_ns: int) -> GelRecord:
        """Count presses of which nothing else is known: they wear the gel."""
        with self._database.writing(f"counting presses of sensor {serial}") as connection:
            ledger.add_presses(connection, serial, time_ns, presses)
            gel, self._newest = self._require_mounted(connection, serial), _newest_number(connection)
        self.keep_count(gel)
        return gel

    def keep_count(self, gel: GelRecord, uncounted: int = 0) -> None:
        """Write its count into the second record. gel: of the last change. uncounted: still waiting. Never raises."""
        self._counts.write(gel.serial, Count.of(gel, self._newest, uncounted))

    def note_uncounted(self, serial: str, presses: int) -> None:
        """Presses of this sensor that are made while the database refuses writes. They are counted when it accepts
        one, or at the next start. Never raises."""
        self._counts.set_uncounted(serial, presses)

    def begin_act(
        self, act: act_table.Act, within_s: float | None = None
    ) -> tuple[int, act_table.Act | None]:
        """Record that this is being done, and return its number; or the same request, when it was done before.

        The same: with the same signature, or of the same verb and transaction id within this time of running. None
        where it is done, or refused, whatever was before.
        """
        with self._database.writing(f"recording the request '{act.verb}'") as connection:
            now_ns = self._running.store(connection)
            known = None
            if act.request is not None and within_s is not None:
                after_ns = now_ns - int(within_s * 1e9)
                known = act_table.earlier(connection, act.verb, act.request, act.signature, after_ns)
            return (known.act_id, known) if known else (act_table.begin(connection, act, now_ns), None)

    def finish_act(
        self,
        act_id: int,
        outcome: act_table.Outcome,
        sentence: str | None = None,
        before: Mapping[str, object] | None = None,
        after: Mapping[str, object] | None = None,
    ) -> None:
        """Record how it ended."""
        with self._database.writing("recording the outcome of a request") as connection:
            act_table.finish(connection, act_id, outcome, sentence, before, after)

    def acts(self, limit: int = 100) -> list[act_table.Act]:
        """The newest acts, newest first."""
        return self.read("reading the acts", lambda connection: act_table.newest(connection, limit))

    def newest_revision(self, part: PartPosition) -> int | None:
        """Read the revision of the newest bundle in use for this position; None where no bundle had one."""
        return self.read(f"reading the revision of {part}", lambda c: bundles_in_use.revision(c, part))

    def use_bundle(
        self,
        part: PartPosition,
        revision: int | None,
        bundle_id: str,
        time_ns: int,
        act: act_table.Act | None = None,
        instead_of: str | None = None,
    ) -> None:
        """Record that this bundle is in use from now on, and that its position is selected. act: recorded with it, both
        or neither. instead_of: the configured bundle whose place it has taken."""
        with self._database.writing(f"selecting {part}") as connection:
            bundles_in_use.use(connection, part, revision, bundle_id, time_ns, instead_of)
            if act is not None:
                act_table.begin(connection, act, self._running.store(connection))

    def close(self) -> None:
        """Close the file; harmless when repeated."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _compare(self, serial: str, time_ns: int) -> None:
        """Compare the sensor's count with the second record, at its first use."""
        if serial in self._compared:
            return
        with self._database.writing(f"comparing the counts of sensor {serial}") as connection:
            # An earlier count that still waits for a receiver would be retained over one that is corrected.
            if recover(connection, self.path, self._counts.read().get(serial), serial, time_ns):
                outbox.forget(connection, "gel")
        self._compared.add(serial)

    def _count(self, connection: sqlite3.Connection, press: PressRecord) -> GelRecord:
        """Count a press on the mounted gel, the first one of an unknown sensor, and return it."""
        arguments = (press.serial, press.time_ns, press.wear_index, self._warn_fraction)
        if (gel := ledger.count_press(connection, *arguments)) is not None:
            return gel
        self._mount_first(connection, press.serial, press.time_ns)
        return self._count(connection, press)

    def _mount_first(self, connection: sqlite3.Connection, serial: str, time_ns: int) -> None:
        if ledger.find_mounted(connection, serial, self._warn_fraction) is None:
            ledger.mount(connection, serial, None, None, self._limit_presses, "first seen", time_ns, NO_LABEL)

    def _require_mounted(self, connection: sqlite3.Connection, serial: str) -> GelRecord:
        gel = ledger.find_mounted(connection, serial, self._warn_fraction)
        if gel is None:
            raise StoreError(f"database {self.path} has no gel of sensor {serial}; run `gelgate gel replace`")
        return gel


def _newest_number(connection: sqlite3.Connection) -> int:
    """The number of the newest press that this database ever had."""
    query = "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'presses'"
    return int(connection.execute(query).fetchone()[0])
