"""A disk that fills up while presses come in."""

from pathlib import Path
from unittest.mock import Mock

import pytest
from full_disk import room_for
from stepped_station import SteppedStation

from edge.cli.gel import replace
from edge.core.errors import StoreError
from edge.store.press_counts import PressCounts
from edge.store.press_store import Store


def test_bundles_are_opened_again_where_the_database_could_not_be_asked_about_them(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is no fault of theirs: the alarm ends without another request."""
    station.turn()
    with monkeypatch.context() as failing:
        failing.setattr(station.parts.store, "read", Mock(side_effect=StoreError("the disk fails")))
        station.reload()
    assert "the disk fails" in str(station.alarm("bundle"))
    station.clock.sleep(6)
    station.turn()
    station.parts.selection.worker.step()
    station.turn()

    assert station.alarm("bundle") is None


class Killed(BaseException):
    """The process ends here."""


def test_a_full_disk_halts_the_station_and_loses_no_press(station: SteppedStation, tmp_path: Path) -> None:
    """The press that finds no room is kept: a halt and an alarm, recorded once there is room. Each press is counted
    once; the alarm is cleared and the station goes on."""
    station.play_presses(1)
    station.publish()
    with room_for((tmp_path / "gelgate.db-wal").stat().st_size):
        station.play_until(lambda: station.loop.is_halted)
        station.publish()
        assert station.said("state")["state"] == "halted"
        assert "free space" in str(station.alarm("store"))
        assert len(station.reports) == 1
    station.turn()
    station.play()
    station.publish()

    assert station.verdicts == ["pass", "fail", "pass"]
    assert [result.is_replayed for result in station.results] == [False, True, False], "what waited is late"
    assert station.alarm("store") is None
    assert station.said("state")["state"] == "ready"
    with Store(tmp_path / "gelgate.db") as store:
        assert [gel.presses for gel in store.gels()] == [3]


def test_no_gel_is_replaced_while_presses_of_it_wait(config: Path, tmp_path: Path) -> None:
    """They would be counted on the new one; from the command line too, which may find room where the station does not.
    Those of a station that died are counted on the old one."""
    database = tmp_path / "gelgate.db"
    with SteppedStation(config) as station:
        station.play_until(lambda: station.loop.session is not None)
        with station.refusing("presses"):
            station.play_until(lambda: station.loop.is_halted)
            with pytest.raises(ValueError, match="a press waits to be recorded; see the alarm `store`"):
                station.ask("replace_gel")
            with pytest.raises(StoreError, match="has 1 press of sensor TEST0001 to record on the old gel"):
                replace(database=database)
        station.turn()
        station.ask("replace_gel")
        assert [gel.presses for gel in station.parts.store.gels()] == [1, 0]
    PressCounts(database).set_uncounted("TEST0001", 2)
    replace(database=database)
    with Store(database) as store:
        assert [gel.presses for gel in store.gels()] == [1, 2, 0]


@pytest.mark.parametrize("is_written", [False, True])
def test_presses_that_wait_are_counted_when_it_is_killed_while_they_are_written(
    config: Path, *, is_written: bool
) -> None:
    """Killed just before or after the second record of the second of three presses: the gel has felt all three."""
    keep, kept = Store.keep_count, list[object]()

    def keep_and_die(*given: object) -> None:
        kept.append(given)
        if is_written or len(kept) == 1:
            keep(*given)
        if len(kept) == 2:
            raise Killed

    with pytest.MonkeyPatch.context() as patched, SteppedStation(config) as station:
        station.play_until(lambda: station.loop.session is not None)
        with station.refusing("presses"):
            station.play_until(lambda: station.loop.session.unrecorded == 3)
        patched.setattr(Store, "keep_count", keep_and_die)
        with pytest.raises(Killed):
            station.turn()
    with SteppedStation(config) as again:
        again.play_until(lambda: again.loop.session is not None)
        assert again.loop.session.gel.presses == 3
        assert "1 presses of sensor TEST0001 were made while it refused writes" in str(again.alarm("counts"))
