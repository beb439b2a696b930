"""A sensor with other colours at a station that has learnt one: its presses are rejected, with any score."""

import json
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
from station import jpeg, press_recording, station_config
from tiny import TINY, tiny_trunk

from calibration.fitting.fit import FitConfig, fit_bundle
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.trunks import Trunk
from edge.clock import SystemClock
from edge.config import load_config
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.gateway.gateway import Gateway
from edge.gateway.recorder import PressReport
from edge.recording.format import Recording, RecordingWriter

PROFILE = profile("cropped_lr")


@pytest.fixture(scope="module")
def lenient(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle whose threshold passes everything, so that only the check before the score can reject a press."""
    folder = tmp_path_factory.mktemp("lenient")
    region = Region.centre(PROFILE.size)
    presses = read_presses([press_recording(folder / "nominal", 4, seed=1)], PROFILE, region)
    config = FitConfig("PZ0", "pos1", PROFILE, region, TINY, Trunk("tiny", tiny_trunk()), threshold=1e6)
    return fit_bundle(folder / "pz0", presses, config, created="2026-01-01")


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same two presses as on the sensor that was learnt, with red and blue lamps exchanged."""
    folder = tmp_path_factory.mktemp("strangers")
    known = Recording.open(press_recording(folder / "known", 2, seed=2))
    with RecordingWriter(folder / "other", known.header) as writer:
        for recorded in known:
            bgr = cv2.imdecode(np.frombuffer(recorded.frame.payload, np.uint8), cv2.IMREAD_COLOR)
            assert bgr is not None
            writer.add(jpeg(np.ascontiguousarray(bgr[..., ::-1])), recorded.frame.timestamp_ns)
    return folder / "other"


def inspected(config: Path) -> list[PressReport]:
    reports: list[PressReport] = []
    with Gateway.open(load_config(config), SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())
    return reports


def test_presses_of_another_sensor_are_rejected(
    tmp_path: Path, lenient: Path, strangers: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Two presses, two rejections with their reason published, no score, never a pass; the start names the light."""
    config = station_config(tmp_path, strangers, lenient)
    results = [report.result for report in inspected(config)]
    lines = [json.loads(line) for line in (tmp_path / "out/messages.jsonl").read_text().splitlines()]
    published = [line["payload"] for line in lines if line["topic"] == "result"]

    assert [result.verdict for result in results] == ["rejected", "rejected"]
    assert [content["verdict"] for content in published] == ["rejected", "rejected"]
    for content in published:
        assert content["reason"].startswith("other_sensor: the colours ")
        assert content["score"] is None
    assert "from the one that the bundle was fitted with: another light, gel or sensor" in caplog.text


def test_a_bundle_without_colours_does_not_check(tmp_path: Path, lenient: Path, strangers: Path) -> None:
    """A bundle from before the check scores them as before; the check prevents this."""
    old = tmp_path / "old"
    old.mkdir()
    for file in lenient.rglob("*"):
        if file.is_file():
            target = old / file.relative_to(lenient)
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(file.read_bytes())
    content = json.loads((old / "manifest.json").read_text())
    del content["colours"]
    (old / "manifest.json").write_text(json.dumps(content))
    reports = inspected(station_config(tmp_path / "station", strangers, old))

    assert [report.result.verdict for report in reports] == ["pass", "pass"]


def test_the_sensor_that_was_learnt_is_scored(tmp_path: Path, lenient: Path, recording: Path) -> None:
    """Sound or dented: its own presses get a verdict."""
    reports = inspected(station_config(tmp_path, recording, lenient))

    assert [report.result.verdict for report in reports] == ["pass", "pass", "pass"]
