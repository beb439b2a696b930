"""A sensor with other colours at a station that has learnt one: its presses are rejected, with any score."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from station import jpeg, press_recording, small_bundle, station_config, variant
from stepped_station import SteppedStation

from edge.recording.format import Recording, RecordingWriter


@pytest.fixture(scope="module")
def lenient(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle whose threshold passes everything, so that only the check before the score can reject a press."""
    folder = tmp_path_factory.mktemp("lenient")
    return small_bundle(folder / "pz0", press_recording(folder / "nominal", 4, seed=1), threshold=1e6)


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same two presses as on the sensor that was learnt, with red and blue lamps exchanged."""
    folder = tmp_path_factory.mktemp("strangers")
    known = Recording.open(press_recording(folder / "known", 2, seed=2))
    with RecordingWriter(folder / "other", known.header) as writer:
        for recorded in known:
            bgr = cv2.imdecode(np.frombuffer(recorded.frame.payload, np.uint8), cv2.IMREAD_COLOR)
            writer.add(jpeg(np.ascontiguousarray(np.asarray(bgr)[..., ::-1])), recorded.frame.timestamp_ns)
    return folder / "other"


def test_presses_of_another_sensor_are_rejected(
    tmp_path: Path, lenient: Path, strangers: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """With their reason and without a score, never a pass; the start names the light."""
    with SteppedStation(station_config(tmp_path, strangers, lenient)) as station:
        station.play()

    assert station.verdicts == ["rejected", "rejected"]
    assert [result.score for result in station.results] == [None, None]
    assert all(str(result.reason).startswith("other_sensor: the colours ") for result in station.results)
    assert "from the one that the bundle was fitted with: another light, gel or sensor" in caplog.text


@pytest.mark.parametrize("is_known", [True, False])
def test_the_sensor_that_was_learnt_is_scored(
    tmp_path: Path, lenient: Path, strangers: Path, recording: Path, is_known: bool
) -> None:
    """So is any at a bundle from before the check, which has no colours: the check is what rejects."""
    bundle = lenient if is_known else variant(lenient, tmp_path / "old", colours=None)
    with SteppedStation(station_config(tmp_path, recording if is_known else strangers, bundle)) as station:
        station.play()
    assert station.verdicts == ["pass"] * (3 if is_known else 2)
