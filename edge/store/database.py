"""The gateway's SQLite file: how it is opened, its tables, and what its errors mean.

Ref: https://www.sqlite.org/wal.html and https://www.sqlite.org/pragma.html#pragma_synchronous. Write-ahead logging lets
the publisher read while the gateway writes; synchronous=FULL makes a committed press survive a power cut.
"""

import sqlite3
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Final

from edge.core.errors import StoreError
from edge.store import ledger_chain

__all__ = [
    "APPLICATION_ID",
    "CHAINED_SINCE",
    "MIGRATIONS",
    "SCHEMA_VERSION",
    "Database",
    "RunningTime",
    "insert",
    "open_read_only",
    "quick_check",
    "refuse_left_journal",
    "schema_version",
]

SCHEMA_VERSION: Final = 15

# The scripts that make each version of the tables from the one before. A new file runs all of them, so it has the same
# tables as one that was migrated. A migration adds; it removes no row. A new column of a table that is chained
# (edge.store.ledger_chain) is NULL in the rows that are there.
MIGRATIONS: Final = tuple(
    files("edge.store").joinpath("migrations", f"version_{number}.sql").read_text(encoding="utf-8")
    for number in range(1, SCHEMA_VERSION + 1)
)

CHAINED_SINCE: Final = 6
"""The first version whose ledger is chained by hash."""

# "GelG" in the file's header: a database of another program is recognised.
APPLICATION_ID: Final = 0x47656C47

# How long a writer waits for another transaction; ours take milliseconds, that of a backup tool perhaps a second.
BUSY_TIMEOUT_S: Final = 5.0

# The write-ahead log is cut back to this after a checkpoint, so that a burst of large heatmaps frees the disk again.
JOURNAL_LIMIT_BYTES: Final = 16 << 20

# Instructions of SQLite's machine between two questions whether to go on: some milliseconds.
ASKED_EVERY: Final = 100_000

# Primary result code to what the operator can do about it. Ref: https://www.sqlite.org/rescode.html
_ADVICE: Final = {
    sqlite3.SQLITE_FULL: "free space on its disk",
    sqlite3.SQLITE_IOERR: "check its disk for faults and free space",
    sqlite3.SQLITE_BUSY: "another program has locked it; end that program",
    sqlite3.SQLITE_LOCKED: "another program has locked it; end that program",
    sqlite3.SQLITE_CORRUPT: "move it away with its -wal to keep both for repair; a new one is made",
    sqlite3.SQLITE_NOTADB: "name another file",
    sqlite3.SQLITE_READONLY: "give the gateway's user the right to write it and its folder",
    sqlite3.SQLITE_CANTOPEN: "create its folder and give the gateway's user the right to write there",
}


# Ref: https://www.sqlite.org/fileformat2.html, bytes 18 and 19 of the file: `back_up` leaves it without a journal.
_NO_JOURNAL: Final = b"\x01\x01"


class Database:
    """One connection to the file. Any thread may use it, one at a time.

    path: made at first use, with its tables. is_durable: commits survive a power cut. Otherwise they survive a crash of
    the process only, at a tenth of the cost. That is enough for acknowledgements: after a loss a message is sent twice.
    migrates: bring older tables to this version; only `edge.store.backup.migrate` does, after a copy.
    Errors: StoreError (of another program, of another version, damaged, no permission, no space).
    """

    def __init__(self, path: Path, *, is_durable: bool = True, migrates: bool = False) -> None:
        self.path = path
        self._lock = threading.RLock()  # a nested transaction is then an error, not a deadlock
        with self._faults("opening"):
            self._connection = sqlite3.connect(
                path, timeout=BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
            )
        try:
            # Text that a damaged page has made unreadable must not keep the rows around it from being read.
            self._connection.text_factory = lambda data: data.decode(errors="replace")
            with self._faults("opening"):
                _prepare(self._connection, path, is_durable, migrates)
            self._file = _identify(path)
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

        The write lock is taken at the start, so that a transaction never fails in the middle because it has none. A
        file that was removed takes everything and keeps nothing, so it is refused.
        """
        with self._lock, self._faults(doing):
            if _identify(self.path) != self._file:
                raise StoreError(
                    f"database {self.path}: {doing} failed (its file was removed or replaced); put it back as it was, "
                    "or restart the gateway"
                )
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

    def _faults(self, doing: str) -> AbstractContextManager[None]:
        return _faults(self.path, doing)


def _identify(path: Path) -> tuple[int, int] | None:
    """Tell which file is at a path: its disk and number; None for none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


@contextmanager
def open_read_only(path: Path, doing: str, *, any_version: bool = False) -> Iterator[sqlite3.Connection]:
    """Open a connection that cannot write, also while a gateway runs; it sees the file in the state of its first query.

    any_version: older tables too. Errors: StoreError (not there, of another program or version, damaged).
    """
    if not path.is_file():
        raise StoreError(f"database {path} does not exist; the gateway makes it at its first run")
    with _faults(path, doing):
        # SQLite needs a journal to read while another process writes. One that is there stays as it is. One that SQLite
        # makes for us is removed at the end only where the file is opened for writing, which `query_only` then forbids.
        real = path.resolve()
        mode = "ro" if real.with_name(f"{real.name}-wal").exists() else "rw"
        uri = f"{real.as_uri()}?mode={mode}"
        with closing(
            sqlite3.connect(uri, uri=True, timeout=BUSY_TIMEOUT_S, isolation_level=None)
        ) as connection:
            connection.text_factory = lambda data: data.decode(errors="replace")
            connection.execute("PRAGMA query_only = 1")
            _refuse_foreign(connection, path)
            if not any_version:
                _refuse_older(connection, path)
            connection.execute("BEGIN")
            yield connection


def refuse_left_journal(path: Path) -> None:
    """Refuse a backup that was put in the place of a file whose journal stayed: SQLite would write that into it.

    It is called before this process has a connection, for closing the file gives up SQLite's locks on it.
    Errors: StoreError.
    """
    real = path.resolve()
    journal = real.with_name(f"{real.name}-wal")
    if not (real.is_file() and journal.is_file() and journal.stat().st_size):
        return
    with real.open("rb") as file:
        is_backup = file.read(20)[18:] == _NO_JOURNAL
    if is_backup:
        raise StoreError(
            f"database {path} is a backup, and {journal.name} next to it is of the file that was there before, which "
            f"would damage it; move {journal.name} and {real.name}-shm away"
        )


def quick_check(path: Path, is_over: Callable[[], bool]) -> str | None:
    """Damage that SQLite sees in the file, as one sentence; None for a sound one. is_over: asked often, ends the check.

    Errors: StoreError for a file that cannot be read; TimeoutError when it was ended.
    """
    with open_read_only(path, "checking", any_version=True) as connection:
        connection.set_progress_handler(is_over, ASKED_EVERY)
        try:
            (answer,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_INTERRUPT:
                raise
            raise TimeoutError(f"the check of database {path} was ended") from error
    return None if answer == "ok" else f"database {path} is damaged ({' '.join(str(answer).split())})"


def insert(connection: sqlite3.Connection, table: str, row: Mapping[str, object]) -> int:
    """Add a row inside the caller's transaction, and return its number. row: column to value."""
    places = ", ".join("?" * len(row))
    cursor = connection.execute(f"INSERT INTO {table} ({', '.join(row)}) VALUES ({places})", (*row.values(),))
    return int(cursor.lastrowid or 0)


def schema_version(connection: sqlite3.Connection) -> int:
    """The version of the tables; 0 for an empty file."""
    return _pragma(connection, "user_version")


@contextmanager
def _faults(path: Path, doing: str) -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, OverflowError) as error:  # a number beyond 64 bits is refused before it is written
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        advice = _ADVICE.get(code, "run `gelgate check`")
        raise StoreError(f"database {path}: {doing} failed ({error}); {advice}") from error


def _prepare(connection: sqlite3.Connection, path: Path, is_durable: bool, migrates: bool) -> None:
    _refuse_foreign(connection, path)
    if not migrates and schema_version(connection) > 0:
        _refuse_older(connection, path)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute(f"PRAGMA synchronous = {'FULL' if is_durable else 'NORMAL'}")
    connection.execute(f"PRAGMA journal_size_limit = {JOURNAL_LIMIT_BYTES}")
    if is_durable:
        # A publisher that commits makes the checkpoint, after SQLite's usual 1000 pages: no press waits for it.
        connection.execute(f"PRAGMA wal_autocheckpoint = {JOURNAL_LIMIT_BYTES >> 12}")
    if _pragma(connection, "user_version") == SCHEMA_VERSION:
        return
    connection.execute("BEGIN IMMEDIATE")
    for script in MIGRATIONS[_pragma(connection, "user_version") :]:  # none if another process was first
        for statement in _statements(script):
            connection.execute(statement)
    ledger_chain.start(connection)
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    connection.execute("COMMIT")


def _refuse_foreign(connection: sqlite3.Connection, path: Path) -> None:
    version = _pragma(connection, "user_version")
    is_empty = connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0] == 0
    if not is_empty and _pragma(connection, "application_id") != APPLICATION_ID:
        raise StoreError(f"database {path} belongs to another program; name another file")
    if version < 0 or (version == 0 and not is_empty):
        raise StoreError(
            f"database {path} has schema version {version}, which no gelgate wrote; move it away to keep it for "
            "repair; a new one is made"
        )
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"database {path} has schema version {version}, this program knows up to {SCHEMA_VERSION}; "
            "use the newer gelgate that wrote it, or name another file"
        )


def _refuse_older(connection: sqlite3.Connection, path: Path) -> None:
    if (version := schema_version(connection)) != SCHEMA_VERSION:
        raise StoreError(
            f"database {path} has schema version {version}, this program reads {SCHEMA_VERSION}; "
            "`gelgate db migrate` brings it there after a copy, and so does a start of the gateway"
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


# Without presses it is stored this often.
STORED_EVERY_NS: Final = 600 * 10**9


class RunningTime:
    """The time that a gateway has run on this database: the clock by which messages age. Use it inside a transaction.

    The wall clock may step by months when a gateway without a clock battery finds a time server, so it says nothing
    about age. Running time only goes forward, at the pace of the monotonic clock: it does not count while no gateway
    runs, and a crash takes back at most the time since it was last stored.
    """

    def __init__(self, monotonic_ns: Callable[[], int]) -> None:
        self._monotonic_ns = monotonic_ns
        self._opened_ns = monotonic_ns()
        self._before_ns: int | None = None  # the running time at the first use

    def now_ns(self, connection: sqlite3.Connection) -> int:
        """Nanoseconds that gateways have run on this database, at least as many as at any call before."""
        stored_ns = self._read_stored(connection)
        if self._before_ns is None:
            self._before_ns = stored_ns
        return max(stored_ns, self._before_ns + self._monotonic_ns() - self._opened_ns)

    def store(self, connection: sqlite3.Connection) -> int:
        """Store the running time, and return it in nanoseconds."""
        if self._before_ns is None:
            self._before_ns = self._read_stored(connection)
        now_ns = self._before_ns + self._monotonic_ns() - self._opened_ns
        query = "UPDATE running SET running_ns = max(running_ns, ?) RETURNING running_ns"
        return int(connection.execute(query, (now_ns,)).fetchone()[0])

    def store_sometimes(self, connection: sqlite3.Connection) -> None:
        """Keep it if that was not done for ten minutes."""
        if self.now_ns(connection) - self._read_stored(connection) >= STORED_EVERY_NS:
            self.store(connection)

    @staticmethod
    def _read_stored(connection: sqlite3.Connection) -> int:
        return int(connection.execute("SELECT running_ns FROM running").fetchone()[0])
