"""`gelgate db`: what is printed, and the exit codes."""

import os
import shutil
from pathlib import Path

from command_line import gelgate
from sql import execute

from edge.messaging.publisher import PublisherLock
from edge.store.database import SCHEMA_VERSION
from edge.store.press_store import PressRecord, Store
from edge.store.ulid import new_ulid

T0 = 1_780_000_000 * 10**9
KEPT = Path(__file__).parents[1] / "compatibility" / "version_0_1_0" / "gelgate.db"


def test_a_sound_database_ends_with_0(database: Path) -> None:
    done = gelgate("db", "check", "--database", database)

    assert (done.code, done.out) == (0, f"ok     {database} is sound\n")


def test_a_fault_is_printed_and_ends_with_1(database: Path) -> None:
    execute(database, "UPDATE gels SET presses = 0")
    done = gelgate("db", "check", "--database", database)

    assert done.code == 1
    assert done.out == (
        "FAULT  gels: gel 2BNN4ZE7-1 of sensor 2BNN4ZE7 counts 0 presses, the history has 1: the count was lowered\n"
        "FAULT  counts: the second record has 1 press of gel 2BNN4ZE7-1 up to number 1, the database 0 up to 1: it "
        "was removed, cut or replaced by an old copy; look for the lost file, or start the gateway, which goes on "
        "from the higher count\n"
    )
    assert "has 2 faults, see above; stop the gateway" in done.sentence()


def test_a_backup_beside_the_journal_of_the_file_before_is_refused(database: Path, tmp_path: Path) -> None:
    """As after a kill, when the backup alone is copied back: SQLite would write the journal into it."""
    gelgate("db", "backup", tmp_path / "backup.db", "--database", database)
    left = tmp_path / "gelgate.db-wal"
    with Store(database) as store:
        press = PressRecord(new_ulid(T0), T0, "2BNN4ZE7", "bolt", "pass")
        store.keep_count(store.record_press(press, lambda gel: []).gel)
        journal = left.read_bytes()  # with the newest press
    shutil.copy(tmp_path / "backup.db", database)
    left.write_bytes(journal)
    refused = gelgate("db", "check", "--database", database)

    assert refused.code == 1
    assert "move gelgate.db-wal and gelgate.db-shm away" in refused.sentence()
    assert database.read_bytes() == (tmp_path / "backup.db").read_bytes()

    left.unlink()
    assert "the second record has 2 presses" in gelgate("db", "check", "--database", database).out


def test_backups_beyond_those_to_keep_are_removed(database: Path, tmp_path: Path) -> None:
    """The oldest first, then what killed ones left a day ago; other names stay, and a copy that is made just now."""
    folder = tmp_path / "kept"
    folder.mkdir()
    for name in ("gelgate-20200101T000000Z.db", "gelgate-20200102T000000Z.db", "notes.db"):
        shutil.copy(database, folder / name)
        (folder / f"{name}.7.part").touch()
    for left in ("gelgate-20200101T000000Z.db.7.part", "notes.db.7.part"):
        os.utime(folder / left, (0, 0))
    done = gelgate("db", "backup", folder, "--database", database, "--keep", "2")

    assert done.code == 0
    removed = ("gelgate-20200101T000000Z.db", "gelgate-20200101T000000Z.db.7.part")
    assert done.out.splitlines()[1:] == [f"{folder}/{name}: removed" for name in removed]
    assert sorted(path.name for path in folder.iterdir())[0] == "gelgate-20200102T000000Z.db"
    assert len(list(folder.iterdir())) == 5


def test_keep_needs_a_folder(database: Path, tmp_path: Path) -> None:
    """With a file there is nothing to remove, and no backup is made."""
    done = gelgate("db", "backup", tmp_path / "one.db", "--database", database, "--keep", "2")

    assert done.code == 3
    assert not (tmp_path / "one.db").exists()


def test_migrate_says_what_was_done(tmp_path: Path) -> None:
    """From which version to which, and where the old file is."""
    path = Path(shutil.copy(KEPT, tmp_path / "gelgate.db"))
    first = gelgate("db", "migrate", "--database", path)
    second = gelgate("db", "migrate", "--database", path)
    (copy,) = tmp_path.glob("gelgate.version1-*Z.db")

    assert first.out == (
        f"{path} migrated from version 1 to {SCHEMA_VERSION}; as it was: {copy}\n"
        "its ledger is chained from here on; the presses and acts from before are not covered\n"
    )
    assert second.out == f"{path} has version {SCHEMA_VERSION}; nothing to do\n"


def test_migrate_refuses_while_a_gateway_publishes(tmp_path: Path) -> None:
    """An older gateway would write the old tables meanwhile."""
    path = Path(shutil.copy(KEPT, tmp_path / "gelgate.db"))
    lock = PublisherLock(path)
    try:
        done = gelgate("db", "migrate", "--database", path)
    finally:
        lock.close()

    assert done.code == 1
    assert "another gelgate process publishes" in done.sentence()


def test_a_database_must_be_there(database: Path) -> None:
    """A mistyped path is no empty ledger."""
    assert "does not exist" in gelgate("db", "check", "--database", database.with_name("typo.db")).sentence()
