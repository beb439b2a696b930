"""A station that is started while a part presses: an alarm, nothing scored, and every later press as usual."""

import json
from pathlib import Path

import numpy as np
from station import FPS, SERIAL, SIZE, gel, jpeg, station_config
from stepped_station import SteppedStation

from edge.recording.format import RecordingHeader, RecordingWriter


def pressed_start(folder: Path, presses: int) -> Path:
    """Two seconds pressed, two free, then presses of a second."""
    rng = np.random.default_rng(3)
    depths = [1.0] * 38 + [0.5] + [0.0] * 38 + ([0.5] + [1.0] * 12 + [0.3] + [0.0] * 12) * presses
    header = RecordingHeader("GelSight Mini R0B TEST-0001", SERIAL, SIZE, FPS, profile="cropped_lr")
    with RecordingWriter(folder, header) as writer:
        for number, depth in enumerate(depths):
            writer.add(jpeg(gel(rng, depth)), round(number * 1e9 / FPS))
    return folder


def said(station: SteppedStation, topic: str) -> str:
    """What an observer who connects now reads on that topic."""
    kept = {message.topic: message.payload for message in station.parts.publisher.retained_state.all()}
    return kept.get(topic, b"").decode()


def test_nothing_is_scored_until_the_free_gel_was_seen(tmp_path: Path, bundle: Path) -> None:
    """The lift is no press, the alarm comes and goes, the stored picture is the free gel's, and two presses are two."""
    config = station_config(tmp_path, pressed_start(tmp_path / "pressed", 2), without_free_view(bundle))
    with SteppedStation(config) as station:
        station.play_until(lambda: "learnt while something pressed" in said(station, "alarm/free_gel"))
        assert not station.reports
        station.play()
        assert not said(station, "alarm/free_gel")

    assert [report.result.verdict for report in station.reports] == ["pass", "pass"]
    kept = sorted(tmp_path.glob("gelgate.references/*/*.npy"))
    assert [path.name.split(".")[-2] for path in kept] == ["first", "last"]
    for path in kept:
        assert np.load(path).std() < 20


def test_the_bundles_free_gel_notices_it_at_once(tmp_path: Path, bundle: Path) -> None:
    """No alarm is needed: the state is that the station waits for the free gel."""
    config = station_config(tmp_path, pressed_start(tmp_path / "pressed", 2), bundle)
    with SteppedStation(config) as station:
        station.play_until(lambda: "something presses it" in said(station, "state"))
        assert not said(station, "alarm/free_gel")
        station.play()

    assert [report.result.verdict for report in station.reports] == ["pass", "pass"]


def without_free_view(bundle: Path) -> Path:
    """The bundle as a program before this one would have written it, and the real one."""
    manifest = json.loads((bundle / "manifest.json").read_text())
    old = bundle.with_name(bundle.name + " without")
    if not old.exists():
        old.mkdir()
        for file in bundle.rglob("*"):
            if file.is_file() and file.name not in ("free_view.png", "manifest.json"):
                target = old / file.relative_to(bundle)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(file.read_bytes())
        del manifest["free_view"]
        (old / "manifest.json").write_text(json.dumps(manifest))
    return old
