"""A copy made while a gateway runs: complete, of one moment, and alone in its file."""

import os
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import pytest
from recorded_presses import count, make_press, record
from sql import execute

from edge.core.errors import StoreError
from edge.store import backup, database
from edge.store.backup import back_up, backups_in, find_leftovers, migrate
from edge.store.database import MIGRATIONS, SCHEMA_VERSION, open_read_only, schema_version
from edge.store.integrity import check_database
from edge.store.press_store import Store

KEPT = Path(__file__).parents[1] / "compatibility" / "version_0_1_0" / "gelgate.db"


def presses(path: Path) -> int:
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as connection:
        return int(connection.execute("SELECT count(*) FROM presses").fetchone()[0])


def test_a_copy_has_what_is_only_in_the_journal_yet(store: Store, path: Path, tmp_path: Path) -> None:
    """The gateway has the file open, and its last presses are in the write-ahead log."""
    for n in (1, 2, 3):
        record(store, make_press(n))
    copy = back_up(path, tmp_path / "copy.db")
    record(store, make_press(4))

    assert (presses(copy), presses(path)) == (3, 4)
    assert check_database(copy) == []
    assert sorted(file.name for file in tmp_path.glob("copy*")) == ["copy.db"]
    assert copy.stat().st_mode & 0o777 == 0o640


def test_a_copy_goes_on_as_a_database(path: Path, tmp_path: Path) -> None:
    """Put in the place of a lost one, without its second record."""
    with Store(path) as store:
        count(store, make_press(1))
    copy = back_up(path, tmp_path / "copy.db")

    with Store(copy) as store:
        assert count(store, make_press(2)).sequence == 2


def test_an_existing_file_is_never_replaced(store: Store, path: Path, tmp_path: Path) -> None:
    (tmp_path / "copy.db").write_text("older")
    with pytest.raises(StoreError, match=r"copy\.db exists already"):
        back_up(path, tmp_path / "copy.db")
    assert (tmp_path / "copy.db").read_text() == "older"


def test_two_backups_at_once_do_not_disturb_each_other(store: Store, path: Path, tmp_path: Path) -> None:
    """Two timers at midnight, into one folder: what the other has begun is neither removed nor written to."""
    code = (
        "import sys; from pathlib import Path; from edge.store.backup import back_up; input(); "
        "back_up(Path(sys.argv[1]), Path(sys.argv[2]))"
    )
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE padding (data)")
        connection.executemany("INSERT INTO padding VALUES (?)", ((bytes(10_000),) for _ in range(2000)))
    command = [sys.executable, "-c", code, path, tmp_path / "copy.db"]
    pipe = subprocess.PIPE
    both = [subprocess.Popen(command, stdin=pipe, stderr=pipe, text=True) for _ in range(2)]
    for one in both:
        assert one.stdin is not None
        one.stdin.write("\n")
        one.stdin.flush()
    said = [one.communicate()[1] for one in both]

    assert [one for one in said if one and "exists already" not in one] == []
    assert [file.name for file in tmp_path.glob("copy*")] == ["copy.db"]
    assert check_database(tmp_path / "copy.db") == []


def test_in_a_folder_the_time_is_in_the_name(store: Store, path: Path, tmp_path: Path) -> None:
    """And such copies are found again, one of before a migration too; others are not, nor are those of another
    station's database of this name."""
    (tmp_path / "kept").mkdir()
    (tmp_path / "other").mkdir()
    Store(tmp_path / "other" / "gelgate.db").close()
    copy = back_up(path, tmp_path / "kept")
    for name in ("gelgate-mine.db", "gelgate-20200101T000000Z.db"):
        shutil.copy(copy, tmp_path / "kept" / name)
    execute(tmp_path / "kept" / "gelgate-20200101T000000Z.db", f"PRAGMA user_version = {SCHEMA_VERSION - 1}")
    back_up(tmp_path / "other" / "gelgate.db", tmp_path / "kept" / "gelgate-20200102T000000Z.db")
    left = {hours: copy.with_name(f"{copy.name}.{hours}.part") for hours in (23, 25)}
    for hours, part in left.items():
        part.touch()
        os.utime(part, (0, time.time() - hours * 3600))

    assert [one.name for one in backups_in(tmp_path / "kept", path)] == [
        "gelgate-20200101T000000Z.db",
        copy.name,
    ]
    assert find_leftovers(tmp_path / "kept", path) == [left[25]]


def test_a_disk_without_room_is_refused_before_the_copy(
    store: Store, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A backup is not what fills the disk."""

    class Usage(NamedTuple):
        free: int

    monkeypatch.setattr(backup.shutil, "disk_usage", lambda folder: Usage(1 << 20))
    with pytest.raises(StoreError, match="has 1 MiB free, the copy needs 64"):
        back_up(path, tmp_path / "copy.db")
    assert list(tmp_path.glob("copy*")) == []


def test_a_damaged_database_leaves_no_copy(path: Path, tmp_path: Path) -> None:
    """Nothing that looks like a backup is kept."""
    with Store(path) as store:
        for n in range(1, 200):
            count(store, make_press(n))
    with path.open("r+b") as file:
        file.seek(4096 * 3)
        file.write(b"\xff" * 4096 * 4)

    with pytest.raises(StoreError, match=r"damaged|malformed"):
        back_up(path, tmp_path / "copy.db")
    assert list(tmp_path.glob("copy*")) == []


def test_an_older_database_is_migrated_after_a_backup(tmp_path: Path) -> None:
    """The copy is the file as it was; the presses are in both; a second time there is nothing to do."""
    path = tmp_path / "gelgate.db"
    path.write_bytes(KEPT.read_bytes())
    before = presses(path)
    version, copy = migrate(path)

    assert version == 1
    assert copy is not None
    assert fnmatch(copy.name, f"gelgate.version1-{'[0-9]' * 8}T{'[0-9]' * 6}Z.db")
    assert presses(copy) == presses(path) == before > 0
    assert migrate(path) == (SCHEMA_VERSION, None)
    assert [finding for finding in check_database(path) if finding.is_fault] == []


def test_a_failed_migration_changes_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every byte of it, next to the copy."""
    path = tmp_path / "gelgate.db"
    path.write_bytes(KEPT.read_bytes())
    monkeypatch.setattr(database, "MIGRATIONS", (*MIGRATIONS[:-1], "CREATE TABLE presses (x);"))
    with pytest.raises(StoreError, match="table presses already exists"):
        migrate(path)

    assert path.read_bytes() == KEPT.read_bytes()
    assert [schema_version_of(one) for one in sorted(tmp_path.iterdir())] == [1, 1]


def schema_version_of(path: Path) -> int:
    with open_read_only(path, "", any_version=True) as connection:
        return schema_version(connection)
