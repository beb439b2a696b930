"""Presses that are made while the database refuses writes: seen, scored, kept, and counted on the gel."""

import json
from pathlib import Path

import pytest
from station import station_config
from stepped_station import SteppedStation

from edge.core.errors import StoreError
from edge.gateway import inspection_session
from edge.store.press_store import Store


def test_presses_made_meanwhile_are_recorded_when_there_is_room(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """All three, in order, each with its verdict."""
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        with station.refusing("presses"):
            station.play()
            assert station.loop.is_halted
            assert station.reports == []
        station.loop.step(None)

        assert [report.result.sequence for report in station.reports] == [1, 2, 3]
        assert [report.result.verdict for report in station.reports] == ["pass", "fail", "pass"]


def test_presses_that_find_no_room_to_wait_are_counted_on_the_gel(
    tmp_path: Path, recording: Path, bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory is bounded: what does not fit has no result, and the gel has felt it."""
    monkeypatch.setattr(inspection_session, "MOST_WAITING", 1)
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        with station.refusing("presses"):
            station.play()
        station.loop.step(None)

        assert len(station.reports) == 1
        assert station.loop.session.gel.presses == 3


def test_a_gateway_that_ends_while_the_database_refuses_leaves_the_count_to_the_next(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """Ended or killed: the next start counts the presses and raises the alarm `counts`."""
    config = station_config(tmp_path, recording, bundle)
    with SteppedStation(config) as station, station.refusing("presses"):
        station.play()
        with pytest.raises(StoreError):
            station.loop._record()

    with SteppedStation(config) as station:
        station.play(3)
        station.loop.publish_stats()
        alarm = {m.topic: m.payload for m in station.parts.publisher.retained_state.all()}["alarm/counts"]
    with Store(tmp_path / "gelgate.db") as store:
        (gel,) = store.gels()

    assert gel.presses == 3
    assert "3 presses of sensor TEST0001 were made while it refused writes" in json.loads(alarm)["text"]


def test_a_lost_database_is_an_alarm_of_the_station(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """The gel goes on counting, and a person is asked to look."""
    config = station_config(tmp_path, recording, bundle)
    with SteppedStation(config) as station:
        station.play()
    for name in ("gelgate.db", "gelgate.db-wal", "gelgate.db-shm"):
        (tmp_path / name).unlink(missing_ok=True)

    with SteppedStation(config) as station:
        station.play(3)
        alarm = {m.topic: m.payload for m in station.parts.publisher.retained_state.all()}["alarm/counts"]
        assert station.loop.session.gel.presses == 3

    assert "presses 1 to 3 are missing" in json.loads(alarm)["text"]
