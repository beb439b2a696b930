"""Stations with several parts: copies of one bundle under other names, and their configuration."""

import json
import shutil
from pathlib import Path
from typing import Any

from station import station_config


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
