"""`check_database`: a sound database has no fault, and each kind of damage is named."""

from pathlib import Path

import pytest
from recorded_presses import SERIAL, count, make_press, record
from sql import add_presses, count_steps, execute

from edge.core.errors import StoreError
from edge.store import integrity
from edge.store.database import open_read_only, quick_check
from edge.store.integrity import Finding, check_database
from edge.store.outbox import Outbox
from edge.store.press_counts import Count, PressCounts
from edge.store.press_store import Store


@pytest.fixture
def used(path: Path) -> Path:
    """A database after a shift: presses on two gels, one message acknowledged, one refused."""
    with Store(path) as store, Outbox(path) as outbox:
        outbox.register(["mqtt"])
        for n in range(1, 5):
            record(store, make_press(n))
            if n == 2:
                store.replace_gel(SERIAL, 0)
        first, second = outbox.pending("mqtt", 2)
        outbox.acknowledge([first.row_id], "mqtt")
        outbox.refuse(second.row_id, "mqtt", "denied")
    return path


def faults(path: Path) -> list[str]:
    return [finding.text for finding in check_database(path) if finding.is_fault]


def test_a_quick_check_ends_when_it_must(used: Path) -> None:
    """A large database would keep a waiting person for minutes."""
    assert quick_check(used, lambda: True) is None
    execute(
        used,
        "CREATE TABLE filler AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 60000) "
        "SELECT i, hex(i) AS text FROM n",
        "CREATE INDEX by_text ON filler (text)",
    )

    assert quick_check(used, lambda: False) is None
    with pytest.raises(TimeoutError, match="was ended"):
        quick_check(used, lambda: True)
    with pytest.raises(StoreError, match="does not exist"):
        quick_check(used.with_name("none.db"), lambda: False)


def test_a_sound_database_has_no_fault(used: Path) -> None:
    """Only what waits is noted."""
    assert check_database(used) == [
        Finding("outbox", "rows that a receiver refused, and that wait: 1", is_fault=False)
    ]


def test_it_may_be_checked_while_a_gateway_writes(used: Path) -> None:
    """An open store keeps the file; the check takes one state of it and changes nothing."""
    with Store(used) as store:
        count(store, make_press(9))
        assert faults(used) == []
        count(store, make_press(10))
    assert faults(used) == []


@pytest.mark.parametrize(
    ("statement", "found"),
    [
        (
            "UPDATE gels SET presses = 1 WHERE removed_ns IS NULL",
            "counts 1 press, the history has 2: the count",
        ),
        ("UPDATE presses SET gel_id = 'lost' WHERE number = 1", "1 are of gels that are not in the ledger"),
        (
            "UPDATE presses SET press_id = 'nonsense' WHERE number = 3",
            "have an id that is no ULID; the first is number 3",
        ),
        ("UPDATE outbox_size SET rows = rows + 1", "its totals say"),
        (
            "INSERT INTO settled VALUES (999, 'mqtt', NULL)",
            "acknowledgements of rows that are not there: 1",
        ),
        (
            "UPDATE outbox SET payload = x'ff7b' WHERE topic = 'last'",
            "rows that hold a message that is no JSON: 1",
        ),
        (
            "UPDATE outbox SET payload = x'7b7d' WHERE topic = 'gel'",
            "rows that have another size than they say",
        ),
        ("DELETE FROM presses WHERE number = 4", "results of presses that the history does not have"),
        (
            "UPDATE presses SET time_ns = (SELECT max(time_ns) FROM presses), "
            "press_id = CASE number WHEN 4 THEN '01ARZ3NDEKTSV4RRFFQ69G5FAV' ELSE press_id END",
            "results of presses that the history does not have",
        ),
    ],
)
def test_each_kind_of_damage_is_a_fault(used: Path, statement: str, found: str) -> None:
    execute(used, statement)

    assert any(found in fault for fault in faults(used)), check_database(used)


def test_results_that_wait_are_not_compared_with_each_press(used: Path) -> None:
    """A receiver may be away for weeks: the history is read once for all of them."""
    add_presses(used, 5000)
    with open_read_only(used, "checking") as connection, count_steps(connection) as steps:
        assert len(list(integrity._outbox(connection))) == 1
    assert len(steps) < 5000 * 6 / 10


def test_presses_that_have_no_result_are_a_note(used: Path) -> None:
    """Made while the database refused writes: normal after a full disk. Those that wait, the next start counts."""
    with Store(used) as store:
        store.count_presses(SERIAL, 3, 0)
    PressCounts(used).set_uncounted(SERIAL, 6)

    assert faults(used) == []
    text = " ".join(finding.text for finding in check_database(used))
    assert "counts 5 presses, the history has 2: the others were made" in text
    assert "not yet counted: 6 presses of sensor 2BNN4ZE7" in text


def test_an_old_copy_is_found_by_the_second_record(used: Path) -> None:
    """The file with the counts knows of presses that the database does not have."""
    for presses, number in ((7, 9), (7, 4), (2, 9)):
        PressCounts(used).write(SERIAL, Count(f"{SERIAL}-2", presses, 1000, number))

        (fault,) = faults(used)
        assert (
            f"has {presses} presses of gel {SERIAL}-2 up to number {number}, the database 2 up to 4" in fault
        )


def test_a_damaged_page_is_found(used: Path) -> None:
    """In one sentence, and nothing else is said about such a file."""
    with used.open("r+b") as file:
        file.seek(4096 * 6)
        file.write(b"\xff" * 4096)

    assert "is damaged" in (quick_check(used, lambda: False) or "")
    assert {finding.part for finding in check_database(used)} == {"file"}


def test_a_file_of_another_program_is_refused(tmp_path: Path) -> None:
    """It is not a damaged one of ours."""
    execute(tmp_path / "other.db", "CREATE TABLE t (x)")

    with pytest.raises(StoreError, match="belongs to another program"):
        check_database(tmp_path / "other.db")
