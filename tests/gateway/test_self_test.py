"""The self-test of a station, and the acknowledgement of alarms that stay."""

import json
import sqlite3
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from unittest.mock import ANY

import pytest
from station import Configure
from stepped_station import SteppedStation

from edge.config import load_config
from edge.core.ports import Message
from edge.core.press import Press
from edge.core.verdict import decide
from edge.features.outputs.stage import Outputs
from edge.messaging.alarm_payload import ALARMS
from edge.store import outbox
from edge.store.press_counts import Count, PressCounts

PEDAL = '\n[[triggers]]\nplugin = "virtual_hid"\naction = "acknowledge"\n'


def self_tested(station: SteppedStation) -> Mapping[str, Any]:
    """The answer of a self-test, after the turns in which nothing presses."""
    finish: Callable[[], Mapping[str, Any]] = station.ask("self_test")
    for _ in range(len(station.parts.selection.inspector.bundle.golden) + 1):
        station.turn()
    found = finish()
    assert json.loads(json.dumps(found)) == found
    return found


def test_a_sound_station_says_so_of_each_part(station: SteppedStation) -> None:
    """Golden frames, database, sensor, receivers and disk, with what was found."""
    station.play_until(lambda: station.loop.session is not None)
    station.publish()
    found = self_tested(station)

    texts = {part: one["text"] for part, one in found["parts"].items()}
    assert found["is_ok"], texts
    assert sorted(texts) == ["disk", "golden", "receivers", "sensor", "store"]
    assert "golden frames" in texts["golden"]
    assert "serial TEST0001" in texts["sensor"]


def test_each_part_that_is_not_well_says_why(station: SteppedStation) -> None:
    """Golden frames that score otherwise, no sensor yet, a receiver that was not tried."""
    scorer = station.parts.selection.inspector.scorer
    scorer._bank["mean"].update_inplace(scorer._bank["mean"].numpy() + 1)
    station.turn()
    parts = self_tested(station)["parts"]
    station.turn()
    fault = station.parts.selection.inspector.fault

    assert {part for part, one in parts.items() if not one["is_ok"]} == {"golden", "receivers", "sensor"}
    assert "golden frame 0" in parts["golden"]["text"]
    assert "not yet tried" in parts["receivers"]["text"]
    assert fault == parts["golden"]["text"]


def test_a_self_test_ends_with_the_station(station: SteppedStation) -> None:
    """Who waits for its golden frames is not kept waiting."""
    finish, stop = station.ask("self_test"), threading.Event()
    stop.set()
    station.loop.turn_until(stop)
    golden = finish()["parts"]["golden"]

    assert not golden["is_ok"]
    assert golden["text"].endswith("were not scored: the station ends")


def drop(station: SteppedStation, pictures: int) -> None:
    """Drop that many pictures from an outbox that holds nothing."""

    def fill(connection: sqlite3.Connection) -> None:
        messages = [Message("heatmap/1", b"png", content_type="image/png")] * pictures
        outbox.put(connection, messages, "pass", 0, 0)
        outbox.enforce(connection, outbox.Bounds(max_bytes=1), 0)

    station.parts.store.write("dropping", fill)


def test_dropped_messages_are_acknowledged_until_more_are_dropped(config: Path) -> None:
    """The alarm of a drop stays over reports and restarts, also where the process ended before it could say so; it
    ends by the request, and comes back with the next drop."""
    with SteppedStation(config) as station:
        drop(station, 1)
    for number, has_acknowledged in ((1, False), (1, True), (2, False)):
        with SteppedStation(config) as station:
            station.loop.publish_stats()
            station.loop.publish_stats()
            assert f"{number} of kind heatmap (no room)" in (station.alarm("outbox_full") or "")
            if has_acknowledged:
                assert station.ask("acknowledge_alarm", alarm="outbox_full") == {"alarms": []}
                station.loop.publish_stats()
                assert station.raised == []
                drop(station, 2)


def test_a_drop_is_said_while_the_store_refuses(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that was set meanwhile cannot be recorded, and keeps back nothing that can be read."""
    drop(station, 1)
    monkeypatch.setattr(station.clock, "time_ns", lambda: station.clock.monotonic_ns() + 86_400 * 10**9)
    with station.refusing("acts"):
        station.loop.publish_stats()
    assert "1 of kind heatmap (no room)" in (station.alarm("outbox_full") or "")


def test_corrected_counts_are_an_alarm_until_a_person_acknowledges_it(config: Path) -> None:
    """Over a restart too, and before the first frame; then no report raises it again."""
    counts = PressCounts(load_config(config).store.path)
    with SteppedStation(config):
        pass
    counts.write("SIM00001", Count("SIM00001-1", 50, 1000, 7))
    with SteppedStation(config) as station:
        station.parts.store.gel("SIM00001", 0)  # as with the first frame
    for lives in range(2):
        with SteppedStation(config) as station:
            station.loop.publish_stats()
            assert station.raised == ["counts"][lives:]
            if not lives:
                assert "SIM00001-1" in (station.alarm("counts") or "")
                assert station.ask("acknowledge_alarm", alarm="counts") == {"alarms": []}
                station.loop.publish_stats()
                assert station.raised == []


def test_pulses_that_were_not_given_are_acknowledged_without_the_verdict(configure: Configure) -> None:
    """The count starts again; the light goes on showing the last verdict."""
    with SteppedStation(configure(tables=PEDAL)) as station:
        io = station.find(Outputs)
        for _ in range(2):
            io.note_late("relay", "41 ms late")
        io.judge(Press(decide(2.0, 1.0), judged_ns=1), None, ANY)
        assert station.ask("acknowledge_alarm", alarm="pulse") == {"alarms": []}
        io.note_late("relay", "7 ms late")
        assert io._verdict == "fail"
        assert "1 pulses were not given in time" in str(station.alarm("pulse"))


def test_each_alarm_that_stays_can_be_acknowledged_and_no_other(station: SteppedStation) -> None:
    """The page offers it for these alone. Others are refused with the reason, and nothing changes."""
    station.parts.status.say("disk", "8 MB free", "warning")
    for alarm, kind in ALARMS.items():
        words = "is not raised; raised: disk" if kind.stays else "ends by itself when its reason is over"
        with pytest.raises(ValueError, match=f"the alarm '{alarm}' {words}"):
            station.ask("acknowledge_alarm", alarm=alarm)
    with pytest.raises(ValueError, match="no alarm is named 'pulses'; did you mean 'pulse'"):
        station.ask("acknowledge_alarm", alarm="pulses")
    assert station.raised == ["disk"]
