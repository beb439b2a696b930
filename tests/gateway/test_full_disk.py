"""A disk that fills up while presses come in."""

from pathlib import Path

from full_disk import room_for
from stepped_station import SteppedStation

from edge.store.press_store import Store


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
    assert station.alarm("store") is None
    assert station.said("state")["state"] == "ready"
    with Store(tmp_path / "gelgate.db") as store:
        assert [gel.presses for gel in store.gels()] == [3]
