"""The history of presses: which rows a query gives, and the files that hold them."""

import csv
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest
from pyarrow import parquet
from recorded_presses import SERIAL, T0, count, make_press

from edge.core.errors import StoreError
from edge.core.gel_life import GelLabel
from edge.store.backup import migrate
from edge.store.database import APPLICATION_ID, MIGRATIONS, SCHEMA_VERSION, open_read_only
from edge.store.history import COLUMNS, HistoryQuery, HistoryRow, list_parts, read_history, write_history
from edge.store.press_store import Store

VERDICTS = ("pass", "fail", "pass", "unsure", "rejected", "error")


@pytest.fixture
def six(store: Store, path: Path) -> Path:
    """Presses 1 to 6, a second apart, one after another of VERDICTS; the last one of another part."""
    for number, verdict in enumerate(VERDICTS, 1):
        press = make_press(number, verdict)
        store.record_press(replace(press, part="nut") if number == 6 else press, lambda recorded: [])
    return path


def numbers(path: Path, query: HistoryQuery) -> list[int]:
    return [row.number for row in read_history(path, query)]


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        (HistoryQuery(), [1, 2, 3, 4, 5, 6]),
        (HistoryQuery(newest=2), [5, 6]),
        (HistoryQuery(since_ns=T0 + 2 * 10**9, until_ns=T0 + 4 * 10**9), [2, 3]),
        (HistoryQuery(verdicts=("pass", "error")), [1, 3, 6]),
        (HistoryQuery(verdicts=("pass",), newest=1), [3]),
        (HistoryQuery(part="nut"), [6]),
        (HistoryQuery(part="bolt", serial=SERIAL, gel=f"{SERIAL}-1", verdicts=("fail",)), [2]),
        (HistoryQuery(position="left"), []),
    ],
)
def test_a_query_gives_what_fits_oldest_first(six: Path, query: HistoryQuery, expected: list[int]) -> None:
    """Every condition holds; a moment `since` is in, a moment `until` is not; the newest of those that fit."""
    assert numbers(six, query) == expected


def test_a_gel_is_found_by_its_own_serial(store: Store, path: Path) -> None:
    """With the presses of each time that it was mounted."""
    count(store, make_press(1))
    for number, serial in enumerate(("G7", "G8", "g7"), 2):
        store.replace_gel(SERIAL, 9, label=GelLabel(serial))
        count(store, make_press(number))

    assert numbers(path, HistoryQuery(gel="G7")) == [2, 4]


def test_a_row_has_what_was_recorded(six: Path) -> None:
    """Number, gel and running time come from the database, the rest from the press."""
    row = next(read_history(six, HistoryQuery(verdicts=("rejected",))))

    assert row.running_s is not None
    assert replace(row, running_s=None, press_id="") == HistoryRow(
        5, "", T0 + 5 * 10**9, None, SERIAL, f"{SERIAL}-1", "bolt", None, "rejected", None, None
    )


def test_reading_writes_nothing_and_needs_no_turn(six: Path, store: Store) -> None:
    """A press that is recorded while the history is read is recorded, and is not in what is read."""
    rows = read_history(six, HistoryQuery())
    first = next(rows).number
    count(store, make_press(7))

    assert [first, *(row.number for row in rows)] == [1, 2, 3, 4, 5, 6]
    assert numbers(six, HistoryQuery(newest=1)) == [7]


def test_a_reader_cannot_write(six: Path) -> None:
    """A mistake in a question changes no row."""
    with pytest.raises(StoreError, match="readonly database"), open_read_only(six, "asking") as connection:
        connection.execute("DELETE FROM presses")
    assert len(numbers(six, HistoryQuery())) == 6


def test_a_database_that_is_not_there_is_not_made(tmp_path: Path) -> None:
    """A mistyped name is one sentence."""
    with pytest.raises(StoreError, match="does not exist"):
        numbers(tmp_path / "typo.db", HistoryQuery())
    assert list(tmp_path.iterdir()) == []


def test_an_older_database_is_not_changed_by_a_question(tmp_path: Path) -> None:
    """The sentence names the verb that migrates it."""
    old = tmp_path / "old.db"
    connection = sqlite3.connect(old)
    connection.executescript(
        f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = 1; CREATE TABLE t (x)"
    )
    connection.close()

    with pytest.raises(
        StoreError, match=f"version 1, this program reads {SCHEMA_VERSION}; `gelgate db migrate`"
    ):
        numbers(old, HistoryQuery())


def test_files_hold_every_field(six: Path, tmp_path: Path) -> None:
    """CSV: column names first, empty cells. Parquet: numbers, moments and missing values; a day without presses."""
    rows = list(read_history(six, HistoryQuery()))
    for name, written in (("presses.csv", rows), ("presses.parquet", rows), ("none.parquet", [])):
        assert write_history(tmp_path / name, written) == len(written)

    with (tmp_path / "presses.csv").open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert tuple(read[0]) == COLUMNS
    assert [row["verdict"] for row in read] == list(VERDICTS)
    assert (read[0]["score"], read[0]["position"], read[5]["score"]) == ("0.5", "", "")
    table = parquet.read_table(tmp_path / "presses.parquet")
    assert table.column_names == parquet.read_table(tmp_path / "none.parquet").column_names == list(COLUMNS)
    assert table["time_ns"].cast("int64").to_pylist() == [row.time_ns for row in rows]
    assert table["score"].to_pylist() == [row.score for row in rows]
    assert table["position"].null_count == 6


def test_a_file_appears_complete_or_not_at_all(six: Path, tmp_path: Path) -> None:
    """Where reading stops half way the earlier file stays as it was, and nothing else is left."""
    target = tmp_path / "out" / "presses.csv"
    target.parent.mkdir()
    target.write_text("yesterday")

    def broken() -> object:
        yield next(read_history(six, HistoryQuery()))
        raise StoreError("the disk is gone")

    with pytest.raises(StoreError, match="the disk is gone"):
        write_history(target, broken())  # type: ignore[arg-type]
    assert [path.name for path in target.parent.iterdir()] == ["presses.csv"]
    assert target.read_text() == "yesterday"


def test_an_unknown_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"presses\.xlsx names no format; known are \.csv, \.parquet"):
        write_history(tmp_path / "presses.xlsx", [])


def test_presses_of_earlier_versions_have_no_cause(path: Path) -> None:
    """A database of version 4 is migrated, keeps its presses, and takes causes from then on."""
    connection = sqlite3.connect(path)
    for script in MIGRATIONS[:4]:
        connection.executescript(script)
    connection.executescript(
        f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = 4;"
        "INSERT INTO presses (press_id, time_ns, serial, gel_id, part, verdict, running_ns) "
        "VALUES ('01ARZ3NDEKTSV4RRFFQ69G5FAV', 1, 'S', 'S-1', 'bolt', 'fail', 0)"
    )
    connection.close()
    migrate(path)
    with Store(path) as store:
        for number, cause in enumerate(("part", "gel", "unsure", None), 2):
            count(store, replace(make_press(number, "fail"), cause=cause))

    causes = [row.cause for row in read_history(path, HistoryQuery())]
    assert causes == [None, "part", "gel", "unsure", None]


def test_parts_that_were_pressed_are_listed(six: Path) -> None:
    assert list_parts(six) == ["bolt/-", "nut/-"]
