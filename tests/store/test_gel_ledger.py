"""The gel ledger: which gel is mounted, how often it was pressed, and the gels before it."""

from datetime import date
from pathlib import Path
from typing import Any

import pytest
from recorded_presses import count, make_press

from edge.core.errors import StoreError
from edge.core.gel_life import GelLabel, GelState
from edge.store.gel_ledger import GelRecord
from edge.store.integrity import check_database
from edge.store.press_store import Store

SERIAL = "2BNN4ZE7"


def test_a_sensor_never_seen_gets_its_first_gel(store: Store) -> None:
    """It is numbered after the sensor and new."""
    gel = store.gel(SERIAL, time_ns=7)

    assert (gel.gel_id, gel.presses, gel.installed_ns, gel.first_use_ns) == ("2BNN4ZE7-1", 0, 7, None)
    assert store.gel(SERIAL, time_ns=9) == gel


def test_each_sensor_has_its_own_count(store: Store) -> None:
    count(store, make_press(1), make_press(2, serial="OTHER"), make_press(3))

    assert {gel.gel_id: gel.presses for gel in store.gels()} == {"2BNN4ZE7-1": 2, "OTHER-1": 1}


def test_replacing_a_gel_starts_at_zero_and_keeps_the_old_one(store: Store) -> None:
    """The act is recorded with its time, limit and note."""
    count(store, make_press(1), make_press(2))

    store.replace_gel(SERIAL, time_ns=50, limit_presses=300, note="torn by a thread")
    count(store, make_press(3))

    old, new = store.gels()
    assert (old.gel_id, old.presses, old.removed_ns) == ("2BNN4ZE7-1", 2, 50)
    assert (new.gel_id, new.presses, new.removed_ns) == ("2BNN4ZE7-2", 1, None)
    assert (new.limit_presses, new.note) == (300, "torn by a thread")


def test_a_used_gel_id_is_refused(store: Store) -> None:
    """A count belongs to one gel; the refused act leaves the mounted gel on."""
    store.replace_gel(SERIAL, 1, gel_id="blue")

    with pytest.raises(StoreError, match="'blue' was already used"):
        store.replace_gel(SERIAL, 2, gel_id="blue")
    assert store.gel(SERIAL, 3).gel_id == "blue"


def test_numbering_steps_over_ids_that_people_chose(store: Store) -> None:
    """An id that happens to be the next number is not used twice."""
    store.replace_gel(SERIAL, 1, gel_id="2BNN4ZE7-2")
    store.replace_gel(SERIAL, 2)
    store.replace_gel(SERIAL, 3)

    assert [gel.gel_id for gel in store.gels()] == ["2BNN4ZE7-2", "2BNN4ZE7-3", "2BNN4ZE7-4"]


def test_the_state_follows_the_limit(path: object) -> None:
    """With a limit of 5 and a warning at 80 %: good up to 3, due at 4, replace from 5 on."""
    with Store(path, limit_presses=5, warn_fraction=0.8) as store:  # type: ignore[arg-type]
        states = [count(store, make_press(n)).gel.state for n in range(6)]

    assert states == ["good", "good", "good", "due", "replace", "replace"]


def test_an_optically_worn_gel_is_to_be_replaced_whatever_its_count(store: Store) -> None:
    """Wear index 1 is the end; a later press without a measurement keeps the last known wear."""
    count(store, make_press(1, wear_index=0.4))
    assert store.gel(SERIAL, 0).state is GelState.GOOD

    count(store, make_press(2, wear_index=1.0), make_press(3))

    gel = store.gel(SERIAL, 0)
    assert (gel.wear_index, gel.state) == (1.0, GelState.REPLACE)


def test_a_clock_set_back_does_not_make_the_last_use_earlier(store: Store) -> None:
    """First use stays the first, last use the latest."""
    count(store, make_press(10), make_press(20), make_press(5))

    gel = store.gel(SERIAL, 0)
    assert (gel.first_use_ns, gel.last_use_ns) == (make_press(10).time_ns, make_press(20).time_ns)


def test_a_gel_change_can_be_published_with_the_act(store: Store) -> None:
    """The new record is handed to the messages, inside the same transaction."""
    seen = []

    store.replace_gel(SERIAL, 1, make_messages=lambda gel: seen.append(gel.gel_id) or [])  # type: ignore[func-returns-value]

    assert seen == ["2BNN4ZE7-1"]


def mount(store: Store, gel_serial: str | None, serial: str = SERIAL, **more: Any) -> GelRecord:
    return store.replace_gel(serial, 9, label=GelLabel(gel_serial, **more))


def test_a_gel_that_is_mounted_again_goes_on(store: Store, path: Path) -> None:
    """By its own serial, in other capitals too and on another sensor: count, limit, type, date and wear. It is another
    row, so what is compared with its first picture adds up; the ledger stays sound."""
    store.replace_gel(SERIAL, 1, limit_presses=4, label=GelLabel("G7", "markers", "2027-01-31"))
    count(store, make_press(1, wear_index=0.5), make_press(2), make_press(3))
    mount(store, "G8")
    again = mount(store, "g7", "OTHER")
    other = mount(store, "G8")
    gel = count(store, make_press(4, wear_index=0.25, serial="OTHER")).gel

    assert (again.presses, again.presses_before, again.limit_presses, again.wear_index) == (3, 3, 4, 0.5)
    assert (again.gel_type, again.use_by, again.first_use_ns) == ("markers", "2027-01-31", None)
    assert again.list_remarks(date(2027, 1, 31)) == [
        "gel serial 'g7' was mounted before: its count goes on from 3 of 4 presses"
    ]
    assert (gel.presses, gel.wear_index, gel.state) == (4, 0.75, "replace")
    assert (other.presses, other.presses_before) == (0, 0)
    assert check_database(path) == []


def test_what_is_said_anew_holds(store: Store) -> None:
    """A mistyped date is corrected by recording the gel once more: nothing of its wear is forgotten."""
    mount(store, "G7", use_by="2017-01-31")
    count(store, make_press(1))
    gel = store.replace_gel(SERIAL, 3, limit_presses=20, label=GelLabel("G7", use_by="2027-01-31"))

    assert (gel.gel_id, gel.presses, gel.limit_presses) == (f"{SERIAL}-2", 1, 20)
    assert gel.use_by == "2027-01-31"


def test_a_gel_is_on_one_sensor(store: Store) -> None:
    """The sentence says where it is, and what to record first; then it may move."""
    mount(store, "G7", "OTHER")
    with pytest.raises(
        StoreError, match=r"gel serial 'G7' is on sensor OTHER, as its gel OTHER-1; correct .* OTHER"
    ):
        mount(store, "G7")
    mount(store, "G8", "OTHER")
    assert mount(store, "G7").presses_before == 0


def test_gels_without_a_serial_are_all_new(store: Store) -> None:
    count(store, make_press(1))
    assert [mount(store, None).presses for _ in range(2)] == [0, 0]


def test_a_lowered_count_of_a_gel_that_goes_on_is_found(store: Store, path: Path) -> None:
    """The presses of before are chained, so they hide nothing."""
    mount(store, "G7")
    count(store, make_press(1), make_press(2))
    mount(store, "G7")
    count(store, make_press(3))
    store.write(
        "lowering it",
        lambda connection: connection.execute("UPDATE gels SET presses = 2 WHERE gel_id LIKE '%-2'"),
    )

    assert "the count was lowered" in str(check_database(path))
