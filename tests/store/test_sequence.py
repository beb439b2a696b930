"""The number of a press: counted once, in the transaction that records it, whatever happens to gels and programs."""

import sqlite3
from pathlib import Path

import pytest
from recorded_presses import count, make_press

from edge.store.backup import migrate
from edge.store.press_store import Store


@pytest.fixture
def old_database(path: Path) -> Path:
    """One that a program wrote which published no sequence numbers: three presses on two gels."""
    script = (Path(__file__).parent / "data" / "gelgate_v1.sql").read_text(encoding="utf-8")
    connection = sqlite3.connect(path)
    connection.executescript(script)
    connection.close()
    return path


def test_a_change_of_gel_or_sensor_and_a_restart_do_not_reset_it(path: Path) -> None:
    """1, 2, 3, 4 while the gel's own count begins again."""
    seen = []
    with Store(path) as store:
        seen.append(count(store, make_press(1)))
        store.replace_gel("2BNN4ZE7", make_press(2).time_ns)
        seen.append(count(store, make_press(2)))
    with Store(path) as store:
        seen.append(count(store, make_press(3)))
        seen.append(count(store, make_press(4, serial="OTHER")))

    assert [one.sequence for one in seen] == [1, 2, 3, 4]
    assert [one.gel.presses for one in seen] == [1, 1, 2, 1]


def test_a_database_of_the_version_before_goes_on_counting(old_database: Path) -> None:
    """Its three presses are 1 to 3, so the next one is 4; its gels and waiting messages are still there."""
    migrate(old_database)
    with Store(old_database) as store:
        gels = [(gel.gel_id, gel.presses) for gel in store.gels()]
        recorded = count(store, make_press(9))

    connection = sqlite3.connect(old_database)
    waiting = connection.execute("SELECT count(*) FROM outbox WHERE topic = 'result'").fetchone()[0]
    connection.close()
    assert gels == [("2BNN4ZE7-1", 2), ("2BNN4ZE7-2", 1)]
    assert (recorded.sequence, recorded.gel.presses) == (4, 2)
    assert waiting == 3
