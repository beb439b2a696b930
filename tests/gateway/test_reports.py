"""What a station says of itself without being asked: its counters at an interval, and the plain `availability`."""

import json
from pathlib import Path

import pytest
from station import station_config
from stepped_station import SteppedStation

from edge.cli.describe import Format, describe_config
from edge.clock import ManualClock
from edge.config import load_config
from edge.core.ports import Message
from edge.gateway.status import StationStatus


@pytest.mark.parametrize(("stats_s", "least", "most"), [(0.5, 8, 10), (60, 0, 0)])
def test_the_interval_of_the_counters_is_configured(
    tmp_path: Path, recording: Path, bundle: Path, stats_s: float, least: int, most: int
) -> None:
    """Five seconds: a report every half second, or none."""
    config = station_config(tmp_path, recording, bundle)
    config.write_text(config.read_text().replace("[device]", f"[station]\nstats_s = {stats_s}\n[device]"))
    times = set()
    with SteppedStation(config) as station:
        for _ in range(50):
            station.clock.sleep(0.1)
            station.loop.step(None)
            said = {
                message.topic: message.payload
                for _, message in station.parts.publisher.retained_state.since(-1)
            }
            times |= {json.loads(said["stats"])["time_ns"]} if "stats" in said else set()

    assert least <= len(times) <= most


def test_a_station_is_online_until_it_ends() -> None:
    """Plain words: also while it is halted, for it runs; the state says that it does not inspect."""
    said: list[Message] = []
    status = StationStatus(said.append, ManualClock())

    status.set_waiting_for("the sensor")
    status.set_fault("device", "no sensor")
    status.stopped()

    words = [message.payload for message in said if message.topic == "availability"]
    assert (words[0], words[-2], words[-1]) == (b"online", b"online", b"offline")


def test_the_counters_name_the_raised_alarms(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """One message has them all, for a dashboard that comes later than the alarms."""
    with SteppedStation(station_config(tmp_path, recording, bundle)) as station:
        for alarm, text in (("bundle", "broken"), ("gel", "worn"), ("device", "away"), ("device", None)):
            station.parts.status.say(alarm, text)
        station.loop.publish_stats()
        said = {
            message.topic: message.payload for _, message in station.parts.publisher.retained_state.since(-1)
        }

    assert json.loads(said["stats"])["alarms"] == ["bundle", "gel"]


def test_a_station_keeps_its_own_description_at_the_broker(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """Retained from the start on: what `gelgate station describe` prints."""
    config = station_config(tmp_path, recording, bundle)
    with SteppedStation(config) as station:
        kept = {message.topic: message.payload for message in station.parts.publisher.retained_state.all()}

    assert json.loads(kept["asyncapi"]) == json.loads(describe_config(load_config(config), Format.ASYNCAPI))
