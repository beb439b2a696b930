"""A station that is started while a part presses: an alarm, nothing scored, and every later press as usual."""

from pathlib import Path

import numpy as np
import pytest
from station import FPS, HEADER, gel, jpeg, station_config, variant
from stepped_station import SteppedStation

from edge.recording.format import RecordingWriter


@pytest.fixture
def pressed(tmp_path: Path) -> Path:
    """Two seconds pressed, two free, then two presses of a second."""
    rng = np.random.default_rng(3)
    depths = [1.0] * 38 + [0.5] + [0.0] * 38 + ([0.5] + [1.0] * 12 + [0.3] + [0.0] * 12) * 2
    with RecordingWriter(tmp_path / "pressed", HEADER) as writer:
        for number, depth in enumerate(depths):
            writer.add(jpeg(gel(rng, depth)), round(number * 1e9 / FPS))
    return tmp_path / "pressed"


def test_nothing_is_scored_until_the_free_gel_was_seen(tmp_path: Path, pressed: Path, bundle: Path) -> None:
    """The lift is no press, the alarm comes and goes, the stored picture is the free gel's, and two presses are two.
    The bundle is one of a program before this one, without a picture of the free gel."""
    old = variant(bundle, tmp_path / "old", free_view=None)
    (old / "free_view.png").unlink()
    with SteppedStation(station_config(tmp_path, pressed, old)) as station:
        station.play_until(lambda: "learnt while something pressed" in str(station.alarm("free_gel")))
        assert not station.reports
        station.play()
        assert station.alarm("free_gel") is None

    assert station.verdicts == ["pass", "pass"]
    kept = [
        *tmp_path.glob("gelgate.references/*/*.first.npy"),
        *tmp_path.glob("gelgate.references/*/*.last.npy"),
    ]
    assert len(kept) == 2
    for path in kept:
        assert np.load(path).std() < 20


def test_two_starts_on_one_part_do_not_prove_each_other_right(
    tmp_path: Path, pressed: Path, bundle: Path
) -> None:
    """What the first one learnt was not known to be a free gel, so the second one does not compare with it."""
    old = variant(bundle, tmp_path / "old", free_view=None)
    (old / "free_view.png").unlink()
    config = station_config(tmp_path, pressed, old)
    with SteppedStation(config) as station:
        station.play_until(lambda: bool(list(tmp_path.glob("gelgate.references/*/*.first.npy"))))
        assert station.said("state")["state"] == "ready"
    with SteppedStation(config) as station:
        station.play()
    assert station.verdicts == ["pass", "pass"]


def test_the_bundles_free_gel_notices_it_at_once(tmp_path: Path, pressed: Path, bundle: Path) -> None:
    """No alarm is needed: the state is that the station waits for the free gel."""
    with SteppedStation(station_config(tmp_path, pressed, bundle)) as station:
        station.play_until(lambda: "something presses it" in str(station.said("state")))
        assert station.alarm("free_gel") is None
        station.play()

    assert station.verdicts == ["pass", "pass"]
