"""A station in a folder: recorded presses, a bundle fitted on them, and a configuration for the gateway.

The fixtures are of every room that runs stations: its `conftest.py` imports them.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tiny import TINY, tiny_trunk

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.trunks import Trunk
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.recording.format import RecordingHeader, RecordingWriter

FPS = 18.75
SERIAL = "TEST0001"
SIZE = (320, 240)
HEADER = RecordingHeader("GelSight Mini R0B TEST-0001", SERIAL, SIZE, FPS, profile="cropped_lr")


@dataclass(frozen=True)
class Motion:
    """Frames of each phase of one press, and of the untouched gel before the first one."""

    free: int = 28
    idle: int = 6
    hold: int = 10


def gel(rng: np.random.Generator, depth: float = 0.0, dent: bool = False) -> NDArray[np.uint8]:
    """A BGR frame: a smooth gel, a ribbed part pressed into it by `depth` (0 to 1), sensor noise of sd 2."""
    clean = _clean(depth, dent)
    start = rng.integers(clean.size)
    return np.clip(clean + _noise()[start : start + clean.size].reshape(clean.shape), 0, 255).astype(np.uint8)


@cache
def _noise() -> NDArray[np.float32]:
    """Enough for two frames: each frame begins at another place, for drawing anew takes longer than all the rest."""
    return 2 * np.random.default_rng(0).standard_normal(2 * 3 * SIZE[0] * SIZE[1], np.float32)


@cache
def _clean(depth: float, dent: bool) -> NDArray[np.float32]:
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    frame = np.stack([120 + 0.1 * y, 130 - 0.05 * x, 110 - 0.1 * y], axis=2)
    inside = ((x - 160) / 70) ** 2 + ((y - 120) / 80) ** 2 < 1
    ribs = 60 * depth * np.sin(y / 3.0) * inside
    if dent:
        ribs = np.where((x - 150) ** 2 + (y - 100) ** 2 < 14**2, -40 * depth, ribs)
    return frame + ribs[..., None] * np.array([1.0, 0.4, -1.0], np.float32)


def jpeg(frame: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


def press_recording(
    folder: Path,
    presses: int,
    *,
    dented: Sequence[int] = (),
    motion: Motion | None = None,
    seed: int = 0,
    fps: float = FPS,
    light: float = 1.0,
    light_at_end: float | None = None,
    shading: float = 0.0,
) -> Path:
    """Untouched gel, then so many presses of one part; those numbered in `dented` are damaged. Labels number them.
    light, light_at_end: of the lamps, as a share; the first throughout where there is no other. shading: of another
    gel, in levels."""
    lamps = (light, light if light_at_end is None else light_at_end)
    film = _film(presses, tuple(dented), motion or Motion(), seed, lamps, shading)
    with RecordingWriter(folder, replace(HEADER, nominal_fps=fps)) as writer:
        for number, (payload, press) in enumerate(film):
            writer.add(payload, round(number * 1e9 / fps), {"press": press})
    return folder


@lru_cache(maxsize=64)
def _film(
    presses: int,
    dented: tuple[int, ...],
    motion: Motion,
    seed: int,
    lamps: tuple[float, float],
    shading: float,
) -> list[tuple[bytes, int | None]]:
    """Each frame with the number of its press: drawn once for the many tests that want the same."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] / SIZE[0]
    added = shading * np.sin(6 * x + 4 * y)[..., None] * np.array([1.0, -0.6, 0.4])
    phases: list[tuple[float, int | None]] = [(0.0, None)] * motion.free
    for press in range(presses):
        phases += [(0.5, press)] + [(1.0, press)] * motion.hold + [(0.3, press)] + [(0.0, None)] * motion.idle
    film = []
    for number, (depth, press) in enumerate(phases):
        frame = gel(rng, depth, press in dented)
        if lamps != (1.0, 1.0) or shading:
            now = lamps[0] + (lamps[1] - lamps[0]) * number / len(phases)
            frame = np.rint(now * (frame + added)).astype(np.uint8)
        film.append((jpeg(frame), press))
    return film


def small_bundle(
    folder: Path,
    nominal: Path,
    sensor: SensorProfile | None = None,
    threshold: float = 0.1,
    part: str = "PZ0",
) -> Path:
    """A bundle fitted on a recording with the smallest detector: what is tested is everything around it."""
    sensor = sensor or profile("cropped_lr")
    region = Region.centre(sensor.size)
    config = FitConfig(part, "pos1", sensor, region, TINY, Trunk("tiny", tiny_trunk()), threshold=threshold)
    return fit_files(read_presses([nominal], sensor, region), config, created="2026-01-01").write(folder)


CONFIG = """
version = 1
[device]
plugin = "usb_mock"
options = {{ recording = "{recording}", pace = {pace}, faults = {faults}, loop = {loop} }}
[inspection]
{inspection}
trigger = "{trigger}"
[store]
path = "gelgate.db"
{store}
{sinks}
{tables}
"""
JSONL = '[[sinks]]\nplugin = "jsonl"\noptions = { folder = "%s" }\n'
MQTT = '[[sinks]]\nplugin = "mqtt"\noptions = { host = "127.0.0.1", port = %d }\n'


def station_config(
    folder: Path,
    recording: Path,
    bundle: Path | str,
    *,
    pace: float = 0.0,
    faults: Sequence[str] = (),
    loop: bool = False,
    trigger: str = "automatic",
    store: str = "",
    sinks: str = "",
    tables: str = "",
) -> Path:
    """Write `gelgate.toml` into the folder; messages go to `out/` in it unless `sinks` is given. bundle: its folder,
    or lines of the table `inspection`. store: lines of that table. tables: further ones."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "gelgate.toml"
    text = CONFIG.format(
        recording=recording,
        pace=pace,
        faults=list(faults),
        loop=str(loop).lower(),
        inspection=bundle if isinstance(bundle, str) else f'bundle = "{bundle}"',
        trigger=trigger,
        store=store,
        sinks=sinks or JSONL % (folder / "out"),
        tables=tables,
    )
    path.write_text(text.replace("'", '"'), encoding="utf-8")
    if isinstance(bundle, Path) and (bundle / "manifest.json").is_file():
        mark_tried(folder / "gelgate.db", bundle)
    return path


Configure = Callable[..., Path]
"""Writes `gelgate.toml` as `station_config` does, of what a test has: its recording, and the fitted bundle."""


def mark_tried(database: Path, *bundles: Path) -> None:
    """Leave the bundles as tried by an earlier start: a child process for one takes longer than most tests.
    tests/model/test_trial.py has what the child holds."""
    digests = [hashlib.sha256((bundle / "manifest.json").read_bytes()).hexdigest() for bundle in bundles]
    programs = f"gelgate {version('gelgate')} onnxruntime {version('onnxruntime')}"
    tried = Path(f"{database}.tried")
    tried.write_text("".join(f"{digest} {programs}\n" for digest in digests))
    tried.chmod(0o600)


def variant(bundle: Path, path: Path, **changes: Any) -> Path:
    """Copy the bundle with these fields of its manifest changed, in the place of an earlier copy; of a table, those
    fields alone that are given."""
    shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(bundle, path)
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_text(json.dumps(_merge(manifest, changes)))
    return path


def _merge(old: Any, new: Any) -> Any:
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return new
    return old | {name: _merge(old.get(name), value) for name, value in new.items()}


def two_parts(folder: Path, bundle: Path) -> str:
    """Make two bundles that differ in part and threshold (every press passes the second); return their line."""
    variant(bundle, folder / "a")
    variant(bundle, folder / "b", part="PZ1", threshold={"value": 1e6})
    return f'bundle_folder = "{folder}"'


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle fitted on six nominal presses."""
    folder = tmp_path_factory.mktemp("bundle")
    return small_bundle(folder / "pz0", press_recording(folder / "nominal", 6, seed=1))


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three presses, the second one dented."""
    return press_recording(tmp_path_factory.mktemp("recording") / "presses", 3, dented=[1], seed=2)
