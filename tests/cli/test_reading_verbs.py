"""Verbs that read change nothing: no table, no file, no journal, also in a database of an earlier version."""

import shutil
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import pytest
from breakable_station import Bench
from command_line import gelgate

from edge.store import ledger_chain
from edge.store.database import APPLICATION_ID, CHAINED_SINCE, MIGRATIONS, SCHEMA_VERSION
from edge.store.press_store import PressRecord, Store
from edge.store.ulid import new_ulid

T0 = 1_780_000_000 * 10**9
VERSION_1 = Path(__file__).parents[1] / "compatibility" / "version_0_1_0" / "gelgate.db"

READING = (
    ("gel", "show"),
    ("history",),
    ("station", "acts"),
    ("db", "check"),
    ("station", "replay", "--all"),
    ("station", "reference", "chart"),
)


def write_database(path: Path, version: int) -> None:
    """As a gateway of that version leaves it: in write-ahead logging, without a journal, one press on one gel."""
    if version == SCHEMA_VERSION:
        with Store(path) as store:
            store.record_press(PressRecord(new_ulid(T0), T0, "S", "bolt", "pass"), lambda recorded: [])
    elif version == 1:
        shutil.copy(VERSION_1, path)
    else:
        with closing(sqlite3.connect(path, isolation_level=None)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
            for script in MIGRATIONS[:version]:
                connection.executescript(script)
            if version >= CHAINED_SINCE:
                ledger_chain.start(connection)
            connection.executescript(
                f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {version};"
                "INSERT INTO gels (serial, gel_id, presses, limit_presses, installed_ns, note) "
                "VALUES ('S', 'S-1', 1, 9, 1, ''); "
                "INSERT INTO presses (press_id, time_ns, serial, gel_id, part, verdict, running_ns) "
                "VALUES ('01ARZ3NDEKTSV4RRFFQ69G5FAV', 1, 'S', 'S-1', 'bolt', 'fail', 0)"
            )


def content(folder: Path) -> Mapping[Path, bytes]:
    """Every file below it."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("version", [1, 4, CHAINED_SINCE, SCHEMA_VERSION - 1, SCHEMA_VERSION])
def test_a_verb_that_reads_changes_no_byte(version: int, bench: Bench) -> None:
    """Without options it finds the station of this folder; an older database is refused with what migrates it."""
    bench.config()
    write_database(bench.folder / "gelgate.db", version)
    before = content(bench.folder)
    refusal = f"has schema version {version}, this program reads {SCHEMA_VERSION}; `gelgate db migrate`"
    for words in READING:
        done = gelgate(*words)

        assert content(bench.folder) == before, words
        if version == SCHEMA_VERSION:
            assert done.code == 0, done.err
        else:
            assert done.code == 1
            assert refusal in done.sentence()


@pytest.mark.parametrize("version", [0, 1, 4, SCHEMA_VERSION])
def test_check_changes_no_byte(version: int, bench: Bench) -> None:
    """Neither a database nor the list of tried bundles is made; an older database is no fault, and is named as such."""
    path = bench.folder / "gelgate.db"
    config = bench.config(database="gelgate.db")
    if version:
        write_database(path, version)
    before = content(bench.folder)
    done = gelgate("check", "-c", config)

    assert done.code == 0, done.err
    assert content(bench.folder) == before
    (line,) = (line for line in done.out.splitlines() if "database" in line)
    assert line.startswith("ok     database: ")
    assert (f"of version {version}: a start migrates it to version {SCHEMA_VERSION}" in line) == (
        0 < version < SCHEMA_VERSION
    )
    assert ("new" in line) == (version == 0)


def test_a_verb_that_writes_refuses_an_older_database(bench: Bench) -> None:
    """As it was, with the way on."""
    bench.config()
    write_database(bench.folder / "gelgate.db", 3)
    before = content(bench.folder)
    done = gelgate("gel", "replace")

    assert done.code == 1
    assert "has schema version 3" in done.sentence()
    assert "`gelgate db migrate` brings it there after a copy" in done.sentence()
    assert content(bench.folder) == before


@pytest.mark.parametrize("version", [1, 7])
def test_a_start_migrates_after_a_copy(version: int, bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    """The copy has the old version and is named in a line; the presses are in both."""
    bench.config()
    path = bench.folder / "gelgate.db"
    write_database(path, version)
    gelgate("run")
    (copy,) = bench.folder.glob(f"gelgate.version{version}-*Z.db")

    assert f"migrated from version {version} to {SCHEMA_VERSION}; as it was: {copy.name}" in caplog.text
    for file, expected in ((copy, version), (path, SCHEMA_VERSION)):
        with closing(sqlite3.connect(file)) as connection:
            assert connection.execute("PRAGMA user_version").fetchone() == (expected,)
            assert connection.execute("SELECT count(*) FROM presses").fetchone()[0] >= 1
