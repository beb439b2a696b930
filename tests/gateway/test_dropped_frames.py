"""A station on a machine that is too slow: lost frames are counted and reported, and a held press keeps its verdict."""

import json
from pathlib import Path

import pytest
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation


@pytest.fixture(scope="module")
def long_presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """28 frames of free gel, then two presses of 62 frames with 20 between."""
    folder = tmp_path_factory.mktemp("long")
    return press_recording(folder / "presses", 2, motion=Motion(hold=60, idle=20), seed=7)


def test_a_press_that_is_held_while_frames_are_dropped_has_one_verdict(
    tmp_path: Path, bundle: Path, long_presses: Path
) -> None:
    """The loop processes no frame for 2 s of the first press: one interruption, and both presses are judged."""
    with SteppedStation(station_config(tmp_path, long_presses, bundle, pace=1.0)) as station:
        station.play(33)  # the sensor is open, and pressed for four frames
        station.read(38)
        station.play()
        summary = station.loop.summary
        station.loop.publish_stats()

    assert [report.result.verdict for report in station.reports] == ["pass", "pass"]
    assert summary.frames.dropped > 15
    assert summary.frames.interrupted == 1


def test_what_was_dropped_is_published_and_the_alarm_is_cleared_when_it_heals(
    tmp_path: Path, bundle: Path, long_presses: Path
) -> None:
    """Raised with the stats of that time, cleared with the next ones, in which nothing was dropped."""
    with SteppedStation(station_config(tmp_path, long_presses, bundle, pace=1.0)) as station:
        station.parts.publisher.start()
        station.play(20)
        station.read(38)
        station.look()
        station.loop.publish_stats()
        station.parts.publisher.stop()
        station.play(40)
        station.loop.publish_stats()
        now = {message.topic: message.payload for message in station.parts.publisher.retained_state.all()}

    lines = [json.loads(line) for line in (tmp_path / "out/messages.jsonl").read_text().splitlines()]
    said = {line["topic"]: line["payload"] for line in lines}
    assert said["stats"]["frames_dropped"] == station.loop.summary.frames.dropped > 15
    assert "too slow" in said["alarm/overload"]["text"]
    assert now["alarm/overload"] == b""


def test_frames_that_a_halted_store_costs_are_no_overload(
    tmp_path: Path, bundle: Path, long_presses: Path
) -> None:
    """A full disk has its own alarm; frames dropped meanwhile do not count as a slow machine."""
    with SteppedStation(station_config(tmp_path, long_presses, bundle, pace=1.0)) as station:
        with station.refusing("presses"):
            station.play_until(lambda: station.loop.is_halted)
            station.read(38)
        station.loop.step(None)
        station.look()
        station.loop.publish_stats()
        now = {message.topic: message.payload for message in station.parts.publisher.retained_state.all()}

    assert station.loop.summary.frames.dropped > 15
    assert now["alarm/overload"] == b""
