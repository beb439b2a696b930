"""The store: a press is one transaction, so that its verdict, count and messages are all stored or none of them.

One SQLite file holds the presses, the gel ledger and the outbox. The gateway writes through a `Store`; the publisher
reads and acknowledges through an `Outbox` on the same file.
"""

import sqlite3
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from edge.core.errors import StoreError
from edge.core.gel import DEFAULT_LIMIT_PRESSES, DEFAULT_WARN_FRACTION
from edge.core.ports import Message
from edge.store import gel_ledger as ledger
from edge.store import outbox
from edge.store.database import Database
from edge.store.gel_ledger import GelRecord
from edge.store.outbox import Bounds
from edge.store.running_time import RunningTime
from edge.store.ulid import is_ulid

__all__ = ["GelRecord", "MakeMessages", "PressRecord", "Recorded", "Store"]

VERDICTS: Final = ("pass", "fail", "unsure", "rejected", "error")

# Rows kept in the press history; about 200 bytes each, so 200 MB. The ledger's counts do not depend on them.
KEPT_PRESSES: Final = 1_000_000


@dataclass(frozen=True)
class Recorded:
    """A press's place in the database.

    gel: the record of its gel, this press included. sequence: counts the presses of this database from 1. No restart
    and no change of gel or sensor resets it, so a missing number tells a subscriber that a press was missed.
    """

    gel: GelRecord
    sequence: int


MakeMessages = Callable[[Recorded], Sequence[Message]]
"""From a press's place to its messages. Called inside the transaction: quick and pure."""


@dataclass(frozen=True)
class PressRecord:
    """One press to record.

    press_id: a ULID. time_ns: wall clock. serial: of the sensor. verdict: pass, fail, unsure, rejected, or error for
    a press that could not be scored. wear_index: optical wear just before this press, None if not measured.
    """

    press_id: str
    time_ns: int
    serial: str
    part: str
    verdict: str
    position: str | None = None
    score: float | None = None
    threshold: float | None = None
    wear_index: float | None = None

    def __post_init__(self) -> None:
        if not is_ulid(self.press_id):
            raise ValueError(f"a press id is a ULID, found {self.press_id!r}")
        if self.verdict not in VERDICTS:
            raise ValueError(f"a recorded verdict is one of {', '.join(VERDICTS)}, found {self.verdict!r}")
        if not self.serial or not self.part:
            raise ValueError(f"a press has a sensor and a part, found {self.serial!r} and {self.part!r}")


class Store:
    """The gateway's side of the database. Any thread may use it, one at a time.

    bounds: of the outbox. limit_presses, warn_fraction: limit of a gel that is not registered, warning of every gel.
    Errors of every method: StoreError; earlier commits stay.
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
        self._database = Database(path)

    @property
    def path(self) -> Path:
        return self._database.path

    def record_press(self, press: PressRecord, make_messages: MakeMessages) -> Recorded:
        """Number the press, count it and queue its messages, all or nothing.

        Recording the same press again changes nothing and returns its number and the gel as it is now, so a caller may
        repeat after an error. Errors: StoreError, also when the id belongs to another press; any error of
        `make_messages`, and then nothing is recorded.
        """
        with self._database.writing(f"recording press {press.press_id}") as connection:
            known = connection.execute(
                "SELECT number, serial, time_ns, verdict, score FROM presses WHERE press_id = ?",
                (press.press_id,),
            ).fetchone()
            if known is not None:
                if known[1:] != (press.serial, press.time_ns, press.verdict, press.score):
                    raise StoreError(f"press id {press.press_id} was already given to another press")
                return Recorded(self._mounted(connection, press.serial), known[0])
            self._mount_first(connection, press.serial, press.time_ns)
            if press.wear_index is not None:
                ledger.set_wear(connection, press.serial, press.wear_index)
            ledger.count_press(connection, press.serial, press.time_ns)
            gel = self._mounted(connection, press.serial)
            running_ns = self._running.store(connection)
            recorded = Recorded(gel, _insert(connection, press, gel.gel_id, running_ns))
            outbox.put(connection, make_messages(recorded), press.verdict, press.time_ns, running_ns)
            outbox.enforce(connection, self._bounds, running_ns)
        return recorded

    def gel(self, serial: str, time_ns: int) -> GelRecord:
        """The gel mounted on this sensor; an unknown sensor gets its first gel."""
        with self._database.writing(f"reading the gel of sensor {serial}") as connection:
            self._mount_first(connection, serial, time_ns)
            self._running.store_sometimes(connection)
            return self._mounted(connection, serial)

    def gels(self, serial: str | None = None) -> list[GelRecord]:
        """Every gel of this sensor, or of all sensors, oldest first; the mounted one has no `removed_ns`."""
        with self._database.reading("reading the gel ledger") as connection:
            return ledger.history(connection, serial, self._warn_fraction)

    def replace_gel(
        self,
        serial: str,
        time_ns: int,
        gel_id: str | None = None,
        limit_presses: int | None = None,
        note: str = "",
        make_messages: Callable[[GelRecord], Sequence[Message]] | None = None,
    ) -> GelRecord:
        """Record that a new gel was mounted; its count starts at 0, and that of the old gel stays as history.

        gel_id None makes the id `<serial>-<n>`. Errors: StoreError for an id that this sensor already had.
        """
        with self._database.writing(f"replacing the gel of sensor {serial}") as connection:
            ledger.mount(connection, serial, gel_id, limit_presses or self._limit_presses, note, time_ns)
            gel = self._mounted(connection, serial)
            if make_messages is not None:
                outbox.put(connection, make_messages(gel), "", time_ns, self._running.store(connection))
        return gel

    def presses(self, limit: int = 100) -> list[tuple[PressRecord, str]]:
        """The newest presses, each with its gel id, newest first."""
        with self._database.reading("reading presses") as connection:
            rows = connection.execute(
                "SELECT press_id, time_ns, serial, part, verdict, position, score, threshold, gel_id FROM presses "
                "ORDER BY number DESC LIMIT ?",
                (limit,),
            ).fetchall()
        return [(PressRecord(*row[:8]), row[8]) for row in rows]

    def check(self) -> None:
        """Read the complete file and compare its indexes. Errors: StoreError naming what is damaged."""
        with self._database.reading("checking") as connection:
            found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if found != "ok":
            damage = " ".join(str(found).split())  # SQLite reports it in several lines
            raise StoreError(
                f"database {self.path} is damaged ({damage}); move it away to keep it for repair; a new one is made"
            )

    def close(self) -> None:
        """Close the file; harmless when repeated."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _mount_first(self, connection: sqlite3.Connection, serial: str, time_ns: int) -> None:
        if ledger.mounted(connection, serial, self._warn_fraction) is None:
            ledger.mount(connection, serial, None, self._limit_presses, "first seen", time_ns)

    def _mounted(self, connection: sqlite3.Connection, serial: str) -> GelRecord:
        gel = ledger.mounted(connection, serial, self._warn_fraction)
        if gel is None:
            raise StoreError(
                f"database {self.path} has no gel for sensor {serial}; run `gelgate gel replace`"
            )
        return gel


def _insert(connection: sqlite3.Connection, press: PressRecord, gel_id: str, running_ns: int) -> int:
    """Add the press to the history and return its number, which SQLite's AUTOINCREMENT never uses twice."""
    number = connection.execute(
        "INSERT INTO presses (press_id, time_ns, serial, gel_id, part, position, verdict, score, threshold, "
        "running_ns) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (
            press.press_id,
            press.time_ns,
            press.serial,
            gel_id,
            press.part,
            press.position,
            press.verdict,
            press.score,
            press.threshold,
            running_ns,
        ),
    ).lastrowid
    connection.execute(
        "DELETE FROM presses WHERE number <= (SELECT max(number) FROM presses) - ?", (KEPT_PRESSES,)
    )
    return int(number or 0)
