"""A station that is started while a part presses: an alarm, nothing scored, and every later press as usual."""

import json
import threading
from pathlib import Path

import numpy as np
from station import FPS, SERIAL, SIZE, gel, jpeg, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.gateway import Gateway
from edge.gateway.recorder import PressReport
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


def test_nothing_is_scored_until_the_free_gel_was_seen(tmp_path: Path, bundle: Path) -> None:
    """The lift is no press, the alarm comes and goes, the stored picture is the free gel's, and two presses are two."""
    config = load_config(
        station_config(tmp_path, pressed_start(tmp_path / "pressed", 2), without_free_view(bundle))
    )
    reports: list[PressReport] = []
    with Gateway.open(config, SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())

    lines = [json.loads(line) for line in (tmp_path / "out/messages.jsonl").read_text().splitlines()]
    alarms = [line["payload"] for line in lines if line["topic"] == "alarm/free_gel"]
    assert [report.result.verdict for report in reports] == ["pass", "pass"]
    assert any(alarm and "learnt while something pressed" in alarm["text"] for alarm in alarms)
    assert not alarms[-1]
    kept = sorted(tmp_path.glob("gelgate.references/*/*.npy"))
    assert [path.name.split(".")[-2] for path in kept] == ["first", "last"]
    for path in kept:
        assert np.load(path).std() < 20


def test_the_bundles_free_gel_notices_it_at_once(tmp_path: Path, bundle: Path) -> None:
    """No alarm is needed: the state is that the station waits for the free gel."""
    config = load_config(station_config(tmp_path, pressed_start(tmp_path / "pressed", 2), bundle))
    reports: list[PressReport] = []
    with Gateway.open(config, SystemClock(), reports.append) as gateway:
        gateway.run(threading.Event())

    lines = [json.loads(line) for line in (tmp_path / "out/messages.jsonl").read_text().splitlines()]
    states = [line["payload"] for line in lines if line["topic"] == "state"]
    assert [report.result.verdict for report in reports] == ["pass", "pass"]
    assert any("something presses it" in (state["reason"] or "") for state in states)


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
