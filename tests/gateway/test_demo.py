"""The demonstration's wiring: its station runs, over a broker, to its subscriber."""

from pathlib import Path

import pytest

from calibration.demo import _inspected
from edge.messaging.local_broker import LocalBroker


def test_the_demo_inspects_over_a_broker(
    tmp_path: Path, recording: Path, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every press is printed, arrives at the subscriber with its heatmap, and is in the ledger."""
    heatmaps = tmp_path / "heatmaps"
    heatmaps.mkdir()
    with LocalBroker() as broker:
        tally = _inspected(tmp_path, bundle, recording, heatmaps, broker)
    tally.show(heatmaps)
    said = capsys.readouterr().out

    assert tally.verdicts == ["pass", "fail", "pass"]
    assert [path.stem for path in sorted(heatmaps.iterdir())] == ["01-pass", "02-fail", "03-pass"]
    assert "3 of 1000 presses, good" in said
    assert "3 results over MQTT" in said
