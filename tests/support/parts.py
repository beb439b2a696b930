"""Stations with several parts: copies of one bundle under other names, their configuration, and what they say."""

import json
import shutil
from pathlib import Path
from typing import Any

from station import station_config
from stepped_station import SteppedStation


def variant(bundle: Path, path: Path, **changes: Any) -> Path:
    """A copy of the bundle whose manifest differs in these fields, written in the place of an earlier one."""
    if path.exists():
        shutil.rmtree(path)
    path.parent.mkdir(exist_ok=True)
    shutil.copytree(bundle, path)
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_text(json.dumps({**manifest, **changes}))
    return path


def threshold(bundle: Path, value: float) -> dict[str, Any]:
    """The manifest's threshold with another value."""
    found: dict[str, Any] = json.loads((bundle / "manifest.json").read_text())["threshold"]
    return {**found, "value": value}


def parts_config(folder: Path, recording: Path, lines: str, **options: Any) -> Path:
    """The station's configuration with these lines instead of its one bundle."""
    path = station_config(folder, recording, Path("-"), **options)
    path.write_text(path.read_text().replace('bundle = "-"', lines))
    return path


def two_parts(folder: Path, bundle: Path) -> Path:
    """Two bundles in a new folder that differ in part and threshold: every press passes the second."""
    folder.mkdir()
    variant(bundle, folder / "a")
    variant(bundle, folder / "b", part="PZ1", threshold=threshold(bundle, 1e6))
    return folder


def retained(station: SteppedStation, topic: str) -> dict[str, object] | None:
    """The payload of a retained status message; None where it is empty or absent."""
    found = [one for one in station.parts.publisher.retained_state.all() if one.topic == topic]
    return json.loads(found[-1].payload) if found and found[-1].payload else None


def turns(station: SteppedStation, count: int) -> None:
    """This number of turns of the loop, without a frame."""
    for _ in range(count):
        station.loop.step(None)
