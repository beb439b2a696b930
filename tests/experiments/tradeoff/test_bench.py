"""A small bench: the whole path of a press, from a frame to a subscriber."""

import json
from pathlib import Path

import pytest
from command_line import gelgate
from station import Motion, press_recording, small_bundle

from calibration.experiments.tradeoff.bench import STAGES


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A bundle, and a recording of three presses."""
    folder = tmp_path_factory.mktemp("bench")
    bundle = small_bundle(folder / "pz0", press_recording(folder / "nominal", 12, seed=1))
    return bundle, press_recording(folder / "presses", 3, seed=2)


def test_every_stage_of_every_press_has_its_time(station: tuple[Path, Path], tmp_path: Path) -> None:
    """Each press comes to the outbox and to a subscriber, with its picture; stages add up; floors are positive."""
    words = ("--presses", 3, "--idle", 1, "--threads", 1, "--folder", tmp_path, "--json")
    ended = gelgate("lab", "bench", *station, *words)
    assert ended.code == 0, ended.err
    found = json.loads(ended.out)
    stages = found["stages"]
    assert set(stages) == set(STAGES)
    assert [stages[name]["count"] for name in ("verdict", "outbox", "subscriber", "picture")] == [3] * 4
    order = [stages[name]["median"] for name in ("verdict", "outbox", "picture")]
    assert order == sorted(order)
    assert min(found["floors"].values()) > 0
    assert found["idle"]["core_share"] > 0
    assert found["machine"]["threads"] == 1


def test_a_recording_without_free_frames_is_refused(station: tuple[Path, Path], tmp_path: Path) -> None:
    """One sentence, before a gateway runs."""
    pressed = press_recording(tmp_path / "pressed", 1, motion=Motion(free=0))
    ended = gelgate("lab", "bench", station[0], pressed)
    assert ended.code == 3
    assert "does not begin with frames that are labelled as free" in ended.err
