"""A second record of the counts, in a small file next to the database: the mounted gel, its last day of use, and how
often it was pressed.

A database may be removed, emptied, cut, or replaced by an old copy; then the wear of the gel would start again at 0.
This file has a fixed size and is overwritten in place, so it can be written on a full disk too, where the database
cannot. It holds two copies, written in turn: a power cut damages at most the one being written.
"""

import fcntl
import json
import logging
import os
import sqlite3
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final, Self

from edge.core.sentence import Sentence
from edge.store import gel_ledger, ledger_chain

__all__ = ["Count", "PressCounts", "acknowledge_corrections", "list_corrections", "recover"]

log = logging.getLogger(__name__)

COPY_BYTES: Final = 8192

# Sensors that are remembered, the last used ones: their entries fit into a copy with the longest ids.
REMEMBERED: Final = 8


@dataclass(frozen=True)
class Count:
    """Of one sensor. presses, limit_presses: of that gel."""

    gel_id: str
    """The mounted gel."""
    presses: int
    limit_presses: int
    sequence: int
    """The number of the newest press of the database."""
    uncounted: int = 0
    """Presses that no database has counted yet."""
    order: int = 0
    """Rises with every change."""
    gel_serial: str | None = None
    """The gel's own."""
    use_by: str | None = None
    """Its last day of use, YYYY-MM-DD."""

    @classmethod
    def of(cls, gel: gel_ledger.GelRecord, sequence: int, uncounted: int = 0) -> Self:
        """Take the count of a gel."""
        known = (gel.gel_id, gel.presses, gel.limit_presses, sequence, uncounted)
        return cls(*known, gel_serial=gel.gel_serial, use_by=gel.use_by)


class PressCounts:
    """The file of one database. Processes take turns; a file that cannot be read is as one that is not there."""

    def __init__(self, database: Path) -> None:
        real = database.resolve()
        self.path = real.with_name(real.name + ".counts")
        self._is_failing = False

    def read(self) -> dict[str, Count]:
        """Sensor to its count."""
        try:
            data = self.path.read_bytes()
        except OSError:
            return {}
        return _newest(data)[1]

    def write(self, serial: str, count: Count) -> None:
        """Keep this count; what is not written is logged once, and no reason to refuse a press."""
        try:
            with self._open() as (file, number, counts):
                order = 1 + max((known.order for known in counts.values()), default=0)
                counts[serial] = replace(count, order=order)
                kept = sorted(counts, key=lambda one: counts[one].order)[-REMEMBERED:]
                _put(file, number + 1, {sensor: counts[sensor] for sensor in kept})
            self._is_failing = False
        except OSError as error:
            if not self._is_failing:
                log.warning("the counts in %s are not kept: %s", self.path, error.strerror or error)
            self._is_failing = True

    def set_uncounted(self, serial: str, uncounted: int) -> None:
        """Presses of this sensor that the database does not take now; nothing for an unknown sensor."""
        count = self.read().get(serial)
        if count is not None and count.uncounted != uncounted:
            self.write(serial, replace(count, uncounted=uncounted))

    @contextmanager
    def _open(self) -> Iterator[tuple[int, int, dict[str, Count]]]:
        """(file, number of the newest copy, its counts), while no other process writes."""
        file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            if os.fstat(file).st_size < 2 * COPY_BYTES:
                os.pwrite(file, bytes(2 * COPY_BYTES), 0)
            yield file, *_newest(os.pread(file, 2 * COPY_BYTES, 0))
        finally:
            os.close(file)


def _put(file: int, number: int, counts: Mapping[str, Count]) -> None:
    text = json.dumps(
        {"number": number, "sensors": {serial: asdict(count) for serial, count in counts.items()}},
        ensure_ascii=False,
    ).encode()
    data = b"%08x %s\n" % (zlib.crc32(text), text)
    os.pwrite(file, data.ljust(COPY_BYTES), (number % 2) * COPY_BYTES)
    os.fdatasync(file)


def _newest(data: bytes) -> tuple[int, dict[str, Count]]:
    """(number, counts) of the newer readable copy; (0, {}) where there is none."""
    copies = [_copy(data[start : start + COPY_BYTES]) for start in (0, COPY_BYTES)]
    return max((copy for copy in copies if copy is not None), key=lambda copy: copy[0], default=(0, {}))


def _copy(data: bytes) -> tuple[int, dict[str, Count]] | None:
    try:
        check, text = data.split(b"\n")[0].split(b" ", 1)
        if int(check, 16) != zlib.crc32(text):
            return None
        content = json.loads(text)
        return content["number"], {serial: Count(**fields) for serial, fields in content["sensors"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def list_corrections(connection: sqlite3.Connection) -> list[str]:
    """Return what was corrected, one sentence each, until a person acknowledges it."""
    return [text for (text,) in connection.execute("SELECT sentence FROM corrected_counts ORDER BY rowid")]


def acknowledge_corrections(connection: sqlite3.Connection) -> None:
    """Forget them: a person has seen them."""
    connection.execute("DELETE FROM corrected_counts")


def recover(
    connection: sqlite3.Connection, path: Path, known: Count | None, serial: str, time_ns: int
) -> bool:
    """Correct the ledger of this database inside the caller's transaction; return whether something was corrected.

    known: the second record of this sensor. A database with a newer press than the record is right about its gel; one
    with older presses only, or with fewer of that gel, was removed, emptied, cut or replaced by an old copy. The higher
    count is used: a gel that is replaced too early costs less than one that is worn out and trusted.
    """
    if known is None:
        return False
    sentences = []
    (newest,) = connection.execute(
        "SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'presses'"
    ).fetchone()
    if newest < known.sequence:
        _continue_numbers(connection, known.sequence)
        _restore_gel(connection, known, serial, time_ns)
        sentences.append(
            Sentence(
                f"presses {newest + 1} to {known.sequence} are missing, so it was removed, damaged or replaced by an "
                f"old copy; gel {known.gel_id} of sensor {serial} goes on from {known.presses} presses. Look for the "
                "lost file; the history, unsent results, proofs and what people said and did in it are lost"
            )
        )
    elif newest == known.sequence and _read_count(connection, known, serial) < known.presses:
        _restore_gel(connection, known, serial, time_ns)
        sentences.append(
            Sentence(
                f"presses of master pieces or of a study are missing, so it was removed, damaged or replaced by an old "
                f"copy; gel {known.gel_id} of sensor {serial} goes on from {known.presses} presses. Look for the lost "
                "file; what people said and did in it is lost"
            )
        )
    # A press that was recorded just before the process died may be in the count, and among those that waited.
    if (uncounted := known.uncounted - _counted_since(connection, known, serial)) > 0:
        gel_ledger.add_presses(connection, serial, time_ns, uncounted)
        sentences.append(
            Sentence(
                f"{uncounted} presses of sensor {serial} were made while it refused writes; they are counted on "
                "the gel now, and their results are lost"
            )
        )
    rows = [(f"database {path}: {sentence}",) for sentence in sentences]
    connection.executemany("INSERT INTO corrected_counts (sentence) VALUES (?)", rows)
    return bool(rows)


def _counted_since(connection: sqlite3.Connection, known: Count, serial: str) -> int:
    """Presses of that gel that the ledger has counted since the second record was written."""
    return max(0, _read_count(connection, known, serial) - known.presses)


def _read_count(connection: sqlite3.Connection, known: Count, serial: str) -> int:
    """Read the ledger's count of that gel; 0 for one that it does not know."""
    query = "SELECT presses FROM gels WHERE serial = ? AND gel_id = ?"
    row = connection.execute(query, (serial, known.gel_id)).fetchone()
    return int(row[0]) if row else 0


def _continue_numbers(connection: sqlite3.Connection, sequence: int) -> None:
    """No number is used twice, so that subscribers see the gap."""
    updated = connection.execute("UPDATE sqlite_sequence SET seq = ? WHERE name = 'presses'", (sequence,))
    if updated.rowcount == 0:
        connection.execute("INSERT INTO sqlite_sequence (name, seq) VALUES ('presses', ?)", (sequence,))


def _restore_gel(connection: sqlite3.Connection, known: Count, serial: str, time_ns: int) -> None:
    connection.execute(
        "UPDATE gels SET removed_ns = ? WHERE serial = ? AND removed_ns IS NULL AND gel_id <> ?",
        (time_ns, serial, known.gel_id),
    )
    connection.execute(
        "INSERT INTO gels (serial, gel_id, presses, limit_presses, installed_ns, note, gel_serial, use_by) "
        "VALUES (?, ?, ?, ?, ?, ?, ?, ?) "
        "ON CONFLICT (serial, gel_id) DO UPDATE SET presses = max(presses, excluded.presses), removed_ns = NULL",
        (
            serial,
            known.gel_id,
            known.presses,
            known.limit_presses,
            time_ns,
            gel_ledger.RESTORED,
            known.gel_serial,
            known.use_by,
        ),
    )
    ledger_chain.append_gels(connection, serial)
