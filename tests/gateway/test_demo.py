"""The demonstration's wiring: its station runs, over a broker, to its subscriber."""

from pathlib import Path

import pytest
from station import Motion, press_recording

from calibration.demo import _inspect
from edge.core.errors import PressesMissed
from edge.messaging.local_broker import LocalBroker


@pytest.mark.parametrize("hold", [10, 0])
def test_the_demo_inspects_over_a_broker(
    tmp_path: Path, recording: Path, bundle: Path, hold: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every press is printed, arrives at the subscriber with its heatmap, and is in the ledger. Presses that are too
    short to be seen are a fault: nothing inspected is not "done"."""
    if not hold:
        recording = press_recording(tmp_path / "short", 2, motion=Motion(hold=0), seed=4)
    heatmaps = tmp_path / "heatmaps"
    heatmaps.mkdir()
    with LocalBroker() as broker:
        tally = _inspect(tmp_path, bundle, recording, heatmaps, broker)
    if not hold:
        with pytest.raises(PressesMissed, match="it holds 2 presses and the run saw 0"):
            tally.check(recording)
        return
    tally.check(recording)
    tally.show(heatmaps)
    said = capsys.readouterr().out

    assert tally.verdicts == ["pass", "fail", "pass"]
    assert [path.stem for path in sorted(heatmaps.iterdir())] == ["01-pass", "02-fail", "03-pass"]
    assert "3 of 1000 presses, good" in said
    assert "3 results over MQTT" in said
