"""A station on a machine that is too slow: lost frames are counted and reported, and a held press keeps its verdict."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.model.scorer import Scored


@pytest.fixture(scope="module")
def long_presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """28 frames of free gel, then two presses of 62 frames with 20 between."""
    folder = tmp_path_factory.mktemp("long")
    return press_recording(folder / "presses", 2, motion=Motion(hold=60, idle=20), seed=7)


@pytest.fixture
def station(tmp_path: Path, bundle: Path, long_presses: Path) -> Iterator[SteppedStation]:
    with SteppedStation(station_config(tmp_path, long_presses, bundle, pace=1.0)) as stepped:
        yield stepped


def test_a_press_that_is_held_while_frames_are_dropped_has_one_verdict(station: SteppedStation) -> None:
    """The loop processes no frame for 2 s of the first press: one interruption, and both presses are judged. The alarm
    is raised with the stats of that time, and cleared with the next ones, in which nothing was dropped."""
    station.play(33)  # the sensor is open, and pressed for four frames
    station.read(38)
    station.look()
    station.loop.publish_stats()
    assert station.said("stats")["frames_dropped"] == station.loop.summary.frames.dropped > 15
    assert "too slow" in str(station.alarm("overload"))
    station.play()
    station.loop.publish_stats()

    assert station.alarm("overload") is None
    assert station.verdicts == ["pass", "pass"]
    assert station.loop.summary.frames.interrupted == 1


@pytest.mark.parametrize("frames", [2, 12, 20])
def test_a_bundle_that_scores_slowly_judges_every_press(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch, frames: int
) -> None:
    """Meanwhile so many frames come; more than 15 of them are dropped. The press is scored when it rests, not before:
    its rest would be interrupted, again and again."""
    scorer = station.parts.selection.inspector.scorer
    score = scorer.score_prepared

    def score_slowly(rgb: NDArray[np.uint8]) -> Scored:
        station.read(frames)
        return score(rgb)

    monkeypatch.setattr(scorer, "score_prepared", score_slowly)
    station.play()
    station.look()

    assert station.verdicts == ["pass", "pass"]


def test_frames_that_a_halted_store_costs_are_no_overload(station: SteppedStation) -> None:
    """A full disk has its own alarm; frames dropped meanwhile do not count as a slow machine."""
    with station.refusing("presses"):
        station.play_until(lambda: station.loop.is_halted)
        station.read(38)
    station.turn()
    station.look()
    station.loop.publish_stats()

    assert station.loop.summary.frames.dropped > 15
    assert station.alarm("overload") is None
