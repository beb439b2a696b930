"""The gateway's SQLite file: how it is opened, its tables, and what its errors mean.

Ref: https://www.sqlite.org/wal.html and https://www.sqlite.org/pragma.html#pragma_synchronous. Write-ahead logging lets
the publisher read while the gateway writes; synchronous=FULL makes a committed press survive a power cut.
"""

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from edge.core.errors import StoreError

__all__ = ["APPLICATION_ID", "SCHEMA_VERSION", "Database"]

# "GelG" in the file's header: a database of another program is recognised.
APPLICATION_ID: Final = 0x47656C47
SCHEMA_VERSION: Final = 1

# How long a writer waits for another transaction; ours take milliseconds, that of a backup tool perhaps a second.
BUSY_TIMEOUT_S: Final = 5.0

# The write-ahead log is cut back to this after a checkpoint, so that a burst of large heatmaps frees the disk again.
JOURNAL_LIMIT_BYTES: Final = 16 << 20

_SCHEMA: Final = """
CREATE TABLE gels (
    serial        TEXT NOT NULL,
    gel_id        TEXT NOT NULL,
    presses       INTEGER NOT NULL DEFAULT 0,
    limit_presses INTEGER NOT NULL,
    installed_ns  INTEGER NOT NULL,
    removed_ns    INTEGER,
    first_use_ns  INTEGER,
    last_use_ns   INTEGER,
    wear_index    REAL,
    note          TEXT NOT NULL,
    PRIMARY KEY (serial, gel_id)
) STRICT;
CREATE UNIQUE INDEX one_mounted_gel ON gels (serial) WHERE removed_ns IS NULL;

CREATE TABLE presses (
    number    INTEGER PRIMARY KEY AUTOINCREMENT,
    press_id  TEXT NOT NULL UNIQUE,
    time_ns   INTEGER NOT NULL,
    serial    TEXT NOT NULL,
    gel_id    TEXT NOT NULL,
    part      TEXT NOT NULL,
    position  TEXT,
    verdict   TEXT NOT NULL,
    score     REAL,
    threshold REAL
) STRICT;

-- The payload is the last column: reading the other columns then reads no page of a heatmap.
CREATE TABLE outbox (
    row_id       INTEGER PRIMARY KEY AUTOINCREMENT,
    worth        INTEGER NOT NULL,
    created_ns   INTEGER NOT NULL,
    bytes        INTEGER NOT NULL,
    topic        TEXT NOT NULL,
    qos          INTEGER NOT NULL,
    retain       INTEGER NOT NULL,
    content_type TEXT NOT NULL,
    expiry_s     INTEGER,
    payload      BLOB NOT NULL
) STRICT;
CREATE INDEX outbox_by_worth ON outbox (worth, row_id);
CREATE INDEX outbox_by_age ON outbox (created_ns);
CREATE INDEX outbox_retained ON outbox (topic) WHERE retain = 1;

-- One line per row and sink that acknowledged it (`refusal` is NULL) or refused it.
CREATE TABLE settled (
    row_id  INTEGER NOT NULL,
    sink    TEXT NOT NULL,
    refusal TEXT,
    PRIMARY KEY (row_id, sink)
) STRICT, WITHOUT ROWID;
CREATE TABLE sinks (name TEXT PRIMARY KEY) STRICT, WITHOUT ROWID;
CREATE TABLE dropped (worth INTEGER PRIMARY KEY, rows INTEGER NOT NULL, bytes INTEGER NOT NULL) STRICT;

CREATE TABLE outbox_size (
    one INTEGER PRIMARY KEY CHECK (one = 1), rows INTEGER NOT NULL, bytes INTEGER NOT NULL
) STRICT;
INSERT INTO outbox_size VALUES (1, 0, 0);
CREATE TRIGGER outbox_grows AFTER INSERT ON outbox BEGIN
    UPDATE outbox_size SET rows = rows + 1, bytes = bytes + NEW.bytes;
END;
CREATE TRIGGER outbox_shrinks AFTER DELETE ON outbox BEGIN
    UPDATE outbox_size SET rows = rows - 1, bytes = bytes - OLD.bytes;
    DELETE FROM settled WHERE row_id = OLD.row_id;
END;
"""

# Primary result code to what the operator can do about it. Ref: https://www.sqlite.org/rescode.html
_ADVICE: Final = {
    sqlite3.SQLITE_FULL: "free space on its disk",
    sqlite3.SQLITE_IOERR: "check its disk for faults and free space",
    sqlite3.SQLITE_BUSY: "another program has locked it; end that program",
    sqlite3.SQLITE_LOCKED: "another program has locked it; end that program",
    sqlite3.SQLITE_CORRUPT: "move the file away to keep it for repair; a new one is made",
    sqlite3.SQLITE_NOTADB: "name another file",
    sqlite3.SQLITE_READONLY: "give the gateway's user the right to write it and its folder",
    sqlite3.SQLITE_CANTOPEN: "create its folder and give the gateway's user the right to write there",
}


class Database:
    """One connection to the file. Any thread may use it, one at a time.

    path: made at first use, with its tables. is_durable: commits survive a power cut. Otherwise they survive a crash of
    the process only, at a tenth of the cost. That is enough for acknowledgements: after a loss a message is sent twice.
    Errors: StoreError (of another program, newer than this program, damaged, no permission, no space).
    """

    def __init__(self, path: Path, *, is_durable: bool = True) -> None:
        self.path = path
        self._lock = threading.RLock()  # a nested transaction is then an error, not a deadlock
        with self._faults("opening"):
            self._connection = sqlite3.connect(
                path, timeout=BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
            )
        try:
            with self._faults("opening"):
                _prepare(self._connection, path, is_durable)
        except BaseException:
            self._connection.close()
            raise

    @contextmanager
    def reading(self, doing: str) -> Iterator[sqlite3.Connection]:
        """The connection, for statements that are each complete alone. Errors: StoreError."""
        with self._lock, self._faults(doing):
            yield self._connection

    @contextmanager
    def writing(self, doing: str) -> Iterator[sqlite3.Connection]:
        """The connection inside one transaction: all or nothing. Errors: StoreError.

        The write lock is taken at the start, so that a transaction never fails in the middle because it has none.
        """
        with self._lock, self._faults(doing):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def close(self) -> None:
        """Close the file; harmless when repeated."""
        with self._lock:
            self._connection.close()

    @contextmanager
    def _faults(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (
            sqlite3.Error,
            OverflowError,
        ) as error:  # a number beyond 64 bits is refused before it is written
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            advice = _ADVICE.get(code, "run `gelgate check`")
            raise StoreError(f"database {self.path}: {doing} failed ({error}); {advice}") from error


def _prepare(connection: sqlite3.Connection, path: Path, is_durable: bool) -> None:
    _refuse_foreign(connection, path)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute(f"PRAGMA synchronous = {'FULL' if is_durable else 'NORMAL'}")
    connection.execute(f"PRAGMA journal_size_limit = {JOURNAL_LIMIT_BYTES}")
    if _pragma(connection, "user_version") == SCHEMA_VERSION:
        return
    connection.execute("BEGIN IMMEDIATE")
    if _pragma(connection, "user_version") != SCHEMA_VERSION:  # no other process was first
        for statement in _statements(_SCHEMA):
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    connection.execute("COMMIT")


def _refuse_foreign(connection: sqlite3.Connection, path: Path) -> None:
    version = _pragma(connection, "user_version")
    is_empty = connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0] == 0
    if not is_empty and _pragma(connection, "application_id") != APPLICATION_ID:
        raise StoreError(f"database {path} belongs to another program; name another file")
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"database {path} has schema version {version}, this program knows up to {SCHEMA_VERSION}; "
            "use the newer gelgate that wrote it, or name another file"
        )


def _pragma(connection: sqlite3.Connection, name: str) -> int:
    return int(connection.execute(f"PRAGMA {name}").fetchone()[0])


def _statements(script: str) -> Iterator[str]:
    """The script's statements one by one: `executescript` would commit between them."""
    statement = ""
    for line in script.splitlines(keepends=True):
        statement += line
        if sqlite3.complete_statement(statement):
            yield statement
            statement = ""
