"""Copies of the database, made while a gateway runs.

Ref: https://www.sqlite.org/backup.html. The copy is one state of the file: all pages are copied in one step, and in
write-ahead logging a reader keeps no writer waiting.
"""

import os
import shutil
import sqlite3
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

from edge.core.errors import StoreError
from edge.store.database import SCHEMA_VERSION, Database, open_read_only, schema_version

__all__ = ["back_up", "backups_in", "find_leftovers", "migrate"]

# Room that is left on the disk of the copy, so that a backup is not what fills it.
SPARE_BYTES: Final = 64 << 20


def back_up(database: Path, target: Path) -> Path:
    """Copy the database to a new file, check the copy, and return its path.

    target: a file that does not exist yet, or a folder, in which the copy is named after the database and the time
    (UTC). The copy needs no other file next to it. It appears complete or not at all.
    Errors: StoreError (not there, target exists, no room, damaged, rights).
    """
    if target.is_dir():
        target = target / f"{database.stem}-{_utc()}.db"
    _refuse_target(database, target)
    part = target.with_name(f"{target.name}.{os.getpid()}.part")  # another one may be made just now
    try:
        part.touch()  # what forbids that is of the copy's folder, not of the database
        _copy(database, part)
        os.chmod(part, 0o640)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(part, target)
    except OSError as error:
        raise StoreError(
            f"backup {target} cannot be written: {error.strerror or error}; check its folder and the free space"
        ) from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return target


def backups_in(folder: Path, database: Path) -> list[Path]:
    """The copies that `back_up` made of this database in this folder, oldest first.

    One of another station's database of the same name is none of them, and neither is what cannot be read.
    """
    own = _read_ledger_id(database)
    copies = sorted(folder.glob(_name_pattern(database)))
    return [copy for copy in copies if own is not None and _read_ledger_id(copy) == own]


def find_leftovers(folder: Path, database: Path) -> list[Path]:
    """Find what killed backups left in this folder: unfinished copies that nobody has written to for a day."""
    leftovers, since_s = [], time.time() - 86_400
    for leftover in folder.glob(f"{_name_pattern(database)}.*.part*"):
        with suppress(FileNotFoundError):  # it has become a copy just now
            if leftover.stat().st_mtime < since_s:
                leftovers.append(leftover)
    return leftovers


def migrate(database: Path) -> tuple[int, Path | None]:
    """Bring the tables to this program's version, after a copy next to the file.

    Returns (version before, copy); the copy is None where nothing was to do. Errors: StoreError; the file is then as it
    was.
    """
    with open_read_only(database, "reading its version", any_version=True) as connection:
        before = schema_version(connection)
    if before in (0, SCHEMA_VERSION):  # 0: an empty file, which gets its tables at its first use
        return before, None
    copy = back_up(database, database.with_name(f"{database.stem}.version{before}-{_utc()}{database.suffix}"))
    Database(database, migrates=True).close()
    return before, copy


def _read_ledger_id(path: Path) -> str | None:
    """Read which ledger a database has; None where that cannot be told, as of one of before the ledgers."""
    try:
        with open_read_only(path, "reading whose it is", any_version=True) as connection:
            row = connection.execute("SELECT ledger_id FROM ledger_start").fetchone()
    except StoreError:
        return None
    return None if row is None else str(row[0])


def _name_pattern(database: Path) -> str:
    digits = "[0-9]"
    return f"{database.stem}-{digits * 8}T{digits * 6}Z.db"


def _utc() -> str:
    return time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())


def _refuse_target(database: Path, target: Path) -> None:
    if target.exists():
        raise StoreError(f"backup {target} exists already; name another file, or a folder")
    if not target.parent.is_dir():
        raise StoreError(f"backup {target}: the folder {target.parent} does not exist; make it")
    if not database.is_file():
        raise StoreError(f"database {database} does not exist; the gateway makes it at its first run")
    wal = database.with_name(database.name + "-wal")
    needed = database.stat().st_size + (wal.stat().st_size if wal.exists() else 0) + SPARE_BYTES
    free = shutil.disk_usage(target.parent).free
    if free < needed:
        raise StoreError(
            f"backup {target}: its disk has {free >> 20} MiB free, the copy needs {needed >> 20}; free space or name "
            "another disk"
        )


def _copy(database: Path, part: Path) -> None:
    """Copy the database and check the copy. Errors: StoreError for a damaged source or copy."""
    with (
        open_read_only(database, "reading it for a backup", any_version=True) as source,
        closing(sqlite3.connect(part)) as copy,
    ):
        source.execute("COMMIT")  # the backup takes its own read lock
        source.backup(copy, pages=-1)
        copy.execute("PRAGMA journal_mode = DELETE")
        answer = copy.execute("PRAGMA quick_check(1)").fetchone()[0]
    if answer != "ok":
        raise StoreError(
            f"database {database} is damaged ({' '.join(str(answer).split())}), and so is its copy; none is kept. "
            "`gelgate db check` says more"
        )
