"""The presses of a database, what the ledger says of their archive, and the archive to read. Nothing is written."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from edge.core.errors import ArchiveError
from edge.store.database import open_read_only
from edge.store.ledger_chain import head
from edge.store.press_archive import OBJECTS, PRESSES, ArchivedPress, Digest

__all__ = ["ArchiveFolder", "KnownPress", "find_press", "presses_since"]

_COLUMNS = "number, press_id, time_ns, evidence"

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
    """The press with this id, or the only one whose id begins so. Errors: ArchiveError, StoreError."""
    wanted = prefix.strip().upper()
    if not wanted.isalnum() or not wanted.isascii():
        raise ArchiveError(
            f"'{prefix:.60}' is no press id; give the 26 letters and digits of a result's press_id, or their beginning"
        )
    presses = list(_presses(database, "press_id >= ? AND press_id < ?", (wanted, wanted + "~"), _SHOWN + 1))
    if len(presses) > 1:
        ids = ", ".join(press.press_id for press in presses[:_SHOWN])
        more = " and more" if len(presses) > _SHOWN else ""
        raise ArchiveError(f"'{prefix}' is the beginning of {ids}{more}; give more of the id")
    if not presses:
        raise ArchiveError(
            f"no press {prefix:.60} is in {_describe(database)}; is it of another station, or older?"
        )
    return presses[0]


def presses_since(database: Path, since_ns: int | None = None) -> Iterator[KnownPress]:
    """Every press from this moment on, oldest first. Errors: ArchiveError, StoreError."""
    return _presses(database, "time_ns >= ?", (min(since_ns or 0, 2**63 - 1),), -1)


def _presses(database: Path, condition: str, values: tuple[object, ...], limit: int) -> Iterator[KnownPress]:
    with open_read_only(database, "reading what is archived") as connection:
        rows = connection.execute(
            f"SELECT {_COLUMNS} FROM presses WHERE {condition} ORDER BY number LIMIT ?", (*values, limit)
        )
        for row in rows:
            yield KnownPress(*row)


def _describe(database: Path) -> str:
    """Describe the database: which ledger, and which presses it has."""
    with open_read_only(database, "reading what is archived") as connection:
        ledger_id = head(connection).ledger_id
        presses, first, last = connection.execute(
            "SELECT count(*), min(press_id), max(press_id) FROM presses"
        ).fetchone()
    return f"database {database} (ledger {ledger_id}, {presses} presses" + (
        f", {first} to {last})" if presses else ")"
    )


class ArchiveFolder:
    """An archive to read. Errors of every method: ArchiveError, which says what is gone or damaged."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def press(self, press_id: str, evidence: bytes | None) -> ArchivedPress:
        """The record of a press. evidence: its SHA-256 by the ledger."""
        if evidence is None:
            raise ArchiveError(
                f"press {press_id} was never archived: it has no judged frame, or the archive was off or without room"
            )
        path = self.folder / PRESSES / f"{press_id}.json"
        data = _read(path, f"press {press_id}")
        if hashlib.sha256(data).digest() != evidence:
            raise ArchiveError(
                f"{path} is not what the ledger says of press {press_id}: it was changed, or is of another database; "
                "take it from a backup"
            )
        try:
            return ArchivedPress.model_validate_json(data)
        except ValidationError as error:
            raise ArchiveError(
                f"{path} cannot be read by this version ({error.errors()[0]['msg']}); use the version that wrote it"
            ) from error

    def read(self, digest: Digest, what: str) -> bytes:
        """The bytes of this SHA-256. what: in words, for errors."""
        path = self.folder / OBJECTS / digest
        data = _read(path, what)
        if hashlib.sha256(data).hexdigest() != digest:
            raise ArchiveError(
                f"{what} is damaged: {path} has another SHA-256 than its name; take it from a backup"
            )
        return data


def _read(path: Path, what: str) -> bytes:
    if path.is_fifo():
        raise ArchiveError(f"{what} cannot be read: {path} is a named pipe; take the file from a backup")
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ArchiveError(
            f"{what} is gone: {path} is not there; only the newest presses are kept ([archive]), older ones are in "
            "backups of the folder, which --archive names"
        ) from None
    except OSError as error:
        raise ArchiveError(f"{what} cannot be read: {path}: {error.strerror}; check its rights") from error
