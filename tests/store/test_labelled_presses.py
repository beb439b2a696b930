"""Presses of master pieces and of gauge studies: on the gel, in tables of their own, once each."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from recorded_presses import count, make_press

from edge.core.errors import StoreError
from edge.core.press import StudyLabel
from edge.core.reference_press.charts import ReferencePress
from edge.core.reference_press.outcome import Imprint
from edge.store import reference_presses, study_presses
from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import check_database
from edge.store.press_store import PressRecord, Store
from edge.store.reference_presses import PieceKey, ReferenceRequest, ReferenceTable
from edge.store.study_presses import StudyTable

KEY = PieceKey("2BNN4ZE7", "bolt", "crest", "M1")


def reference(press: PressRecord, **fields: object) -> ReferencePress:
    imprint = Imprint(2.0, 9.0, 7.0, None, 1.0)
    scores = (press.verdict, press.score, press.threshold)
    return ReferencePress(
        press.press_id, press.time_ns, "2BNN4ZE7-1", "b1", "pass", *scores, imprint, **fields
    )  # type: ignore[arg-type]


def test_a_reference_press_counts_on_the_gel_and_not_in_the_history(store: Store, path: Path) -> None:
    """Its own number, the gel's next count, and the number of the next part press is not used up."""
    count(store, make_press(1))
    table = ReferenceTable(KEY, reference(make_press(2)))
    recorded = store.record_press(make_press(2), lambda recorded: [], table)
    part = count(store, make_press(3))

    assert (recorded.sequence, recorded.gel.presses) == (1, 2)
    assert (part.sequence, part.gel.presses) == (2, 3)
    assert [row.number for row in read_history(path, HistoryQuery())] == [1, 2]
    assert table.presses == [reference(make_press(2))]
    assert check_database(path) == []


def test_the_same_press_again_is_one_press(store: Store) -> None:
    """As every press: a caller may repeat after an error."""
    for _ in range(2):
        recorded = store.record_press(
            make_press(1), lambda recorded: [], ReferenceTable(KEY, reference(make_press(1)))
        )

    assert (recorded.sequence, recorded.gel.presses) == (1, 1)


def test_presses_of_another_piece_sensor_or_part_are_others(store: Store, path: Path) -> None:
    """Each has its charts."""
    keys = [KEY, KEY._replace(piece="M2"), KEY._replace(part="nut"), KEY._replace(serial="OTHER")]
    for n, key in enumerate(keys):
        press = make_press(n)
        store.record_press(press, lambda recorded: [], ReferenceTable(key, reference(press)))
    found = reference_presses.read_pieces(path)

    assert {str(key): len(presses) for key, presses in found.items()} == {str(key): 1 for key in keys}


def test_a_count_that_was_lost_goes_on_after_a_reference_press(path: Path) -> None:
    """The second record of the counts has the number of the newest part press, not that of a reference press."""
    with Store(path) as store:
        for n in range(3):
            count(store, make_press(n))
        press = make_press(3)
        table = ReferenceTable(KEY, reference(press))
        store.keep_count(store.record_press(press, lambda recorded: [], table).gel)
    path.unlink()
    with Store(path) as store:
        after = count(store, make_press(4))

    assert (after.sequence, after.gel.presses) == (4, 5)


def test_a_request_of_the_command_line_is_taken_once(store: Store) -> None:
    """The newest one; what was withdrawn is not done later."""
    first, second = (ReferenceRequest(name, "kim", "M1", False, 5) for name in ("a", "b"))
    for wish in (first, second):
        store.write("asking", partial(reference_presses.ask, wish=wish))

    assert store.write("taking", reference_presses.take_request) == second
    assert store.write("taking", reference_presses.take_request) is None
    store.write("asking", partial(reference_presses.ask, wish=first))
    assert store.write("withdrawing", partial(reference_presses.withdraw, request="a"))
    assert not store.write("withdrawing", partial(reference_presses.withdraw, request="a"))
    assert store.write("taking", reference_presses.take_request) is None


def test_a_study_keeps_its_plan_and_its_presses(store: Store, path: Path) -> None:
    """In order; a press that is void stays as a row; a plan is not exchanged under its presses."""
    store.write("beginning", partial(study_presses.begin_study, study_id="s1", plan="first", time_ns=7))
    again = store.write(
        "beginning", partial(study_presses.begin_study, study_id="s1", plan="other", time_ns=9)
    )
    for n in range(3):
        table = StudyTable(StudyLabel("s1", n, f"P{n}", "A", 1), "b1", None)
        store.record_press(make_press(n), lambda recorded: [], table)
    gone = make_press(1).press_id
    assert store.write("voiding", partial(study_presses.void, press_id=gone))
    assert not store.write("voiding", partial(study_presses.void, press_id=gone))
    plan, presses = study_presses.read_study(path, "s1") or ("", [])

    assert (again, plan) == ("first", "first")
    assert [(one.step, one.piece, one.is_void) for one in presses] == [
        (0, "P0", False),
        (1, "P1", True),
        (2, "P2", False),
    ]
    assert study_presses.studies(path) == [("s1", 7, 2)]
    assert study_presses.read_study(path, "other") is None
    assert check_database(path) == []


@pytest.mark.parametrize(
    "read",
    [reference_presses.read_pieces, study_presses.studies, partial(study_presses.read_study, study_id="s")],
)
def test_an_older_database_is_unread_until_migrated(read: Callable[[Path], object], tmp_path: Path) -> None:
    """One sentence that says how."""
    old = Path(__file__).parents[1] / "compatibility" / "version_0_1_0" / "gelgate.db"
    copy = Path(shutil.copy(old, tmp_path / "old.db"))

    with pytest.raises(StoreError, match=r"has schema version 1, .*`gelgate db migrate`"):
        read(copy)
