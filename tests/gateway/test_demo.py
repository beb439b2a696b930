"""The demonstration's wiring: its station runs, over a broker, to its subscriber."""

from pathlib import Path

import pytest

from calibration.demo import _inspected, _Tally
from edge.messaging.local_broker import LocalBroker

README = Path(__file__).parents[2] / "README.md"


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


def test_the_readme_ends_the_demo_as_the_program_does(capsys: pytest.CaptureFixture[str]) -> None:
    """Twelve presses, five of them damaged, all found."""
    damaged = {number: number in (2, 5, 6, 8, 10) for number in range(12)}
    verdicts = ["fail" if is_damaged else "pass" for is_damaged in damaged.values()]
    gel = "SIM00001-1 on sensor SIM00001: 12 of 1000 presses, good"
    _Tally(damaged, {}, verdicts, gel, received=12).show(Path("demo/heatmaps"))

    assert capsys.readouterr().out.strip() in README.read_text(encoding="utf-8")
