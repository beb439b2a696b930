"""Golden frames of a running station: scored after every change and every hour; no verdict while they fail."""

from pathlib import Path

import pytest
from station import Motion, press_recording, station_config, two_parts
from stepped_station import SteppedStation

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.part_position import PartPosition
from edge.gateway.opening import BundleOpener

PZ0, PZ1 = PartPosition("PZ0", "pos1"), PartPosition("PZ1", "pos1")


@pytest.fixture
def bundles(tmp_path: Path, bundle: Path) -> str:
    return two_parts(tmp_path / "bundles", bundle)


def test_golden_frames_are_scored_after_every_change_and_every_hour(tmp_path: Path, bundles: str) -> None:
    """A bundle whose frames score otherwise gives no verdict, and the station says so; it heals by itself."""
    recording = press_recording(tmp_path / "presses", 1, motion=Motion(idle=12), seed=5)
    config = station_config(tmp_path / "station", recording, bundles)
    with SteppedStation(config) as station:
        station.play_until(lambda: station.loop.session is not None)
        scorer = station.parts.selection.inspector.scorer
        mean = scorer._bank["mean"].numpy().copy()
        scorer._bank["mean"].update_inplace(mean + 1)
        station.turn(3)
        assert station.alarm("golden") is None

        station.clock.sleep(3601)
        station.turn(len(scorer.bundle.golden))
        assert "golden frame 0" in str(station.alarm("golden"))
        assert station.said("state")["state"] == "halted"
        assert station.parts.selection.inspector.fault is not None

        before = station.parts.selection.bundles
        again = BundleOpener(None, 1, SystemClock()).open(load_config(config).inspection, before).bundles
        assert [again[part].inspector is before[part].inspector for part in (PZ0, PZ1)] == [False, True]

        scorer._bank["mean"].update_inplace(mean)
        station.clock.sleep(61)
        station.turn(len(scorer.bundle.golden))
        assert station.alarm("golden") is None
        assert station.parts.selection.inspector.fault is None

        other = station.parts.selection.bundles[PZ1].inspector.scorer
        other._bank["mean"].update_inplace(mean + 1)
        station.ask("select_part", part="PZ1")
        station.turn(len(scorer.bundle.golden))
        assert "golden frame 0" in str(station.alarm("golden"))
        station.ask("select_part", part="PZ0")
        assert station.alarm("golden") is None
