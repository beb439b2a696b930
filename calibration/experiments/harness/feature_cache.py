"""Feature maps in files, found by their content: extracted once, shared by all processes through memory maps."""

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime as ort

from calibration.experiments.harness.pictures import PressPictures
from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.trunks import Trunk
from calibration.folders import claim
from edge.core.detector import Features, Grid, Progress
from edge.core.errors import ConfigError, StoreError
from edge.model.manifest import GridEntry
from edge.model.session import open_session

__all__ = ["Taken", "take_features"]

CACHE_FORMAT = 1
_GRID_FILE = "grid.json"

# Pictures decoded at once: memory stays small also for 1280x720.
_AT_ONCE = 16


@dataclass(frozen=True)
class Taken:
    """Features and their geometry."""

    grid: Grid
    features: Features
    """Tap to float32 (n, c, h, w), memory-mapped and read-only."""

    def grid_of(self, taps: Sequence[str]) -> Grid:
        """The geometry of some taps."""
        grid = self.grid
        return Grid(grid.frame, {tap: grid.taps[tap] for tap in taps}, grid.pixels_per_mm, grid.tiles)


def take_features(
    folder: Path,
    trunk: Trunk,
    taps: Sequence[str],
    pictures: PressPictures,
    progress: Progress = lambda fraction: None,
    threads: int = 1,
) -> Taken:
    """Return the trunk's taps for the pictures from a folder of features, where they are extracted once.

    An entry is of one trunk, taps, pictures and runtime. Several processes may use the folder: an entry appears
    complete or not at all. Errors: ConfigError for a cache of another format, or a folder that is none; FitError,
    DatasetError; StoreError for a full disk.
    """
    way_on = "choose an empty --cache"
    claim(folder, "cache.json", {"format": CACHE_FORMAT}, "cache of features", ConfigError, way_on)
    entry = folder / _key(trunk, taps, pictures)
    features = _open_entry(entry)
    if features is None:
        _add(entry, lambda part: _write(part, trunk, taps, pictures, progress, threads))
        features = _open_entry(entry)
    if features is None:
        raise StoreError(
            f"'{entry}' was written and cannot be read; see to the disk, or choose another --cache"
        )
    progress(1.0)
    return features


def _add(entry: Path, write: Callable[[Path], None]) -> None:
    """Write an entry under another name, then give it its own."""
    shutil.rmtree(entry, ignore_errors=True)
    part = Path(tempfile.mkdtemp(prefix="part-", dir=entry.parent))
    try:
        write(part)
        os.rename(part, entry)
    except OSError as error:
        if not entry.is_dir():  # else another process was faster
            raise StoreError(
                f"the features cannot be written to '{entry.parent}': {error.strerror}; "
                "free some space or choose another folder with --cache, and give the same command again"
            ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _key(trunk: Trunk, taps: Sequence[str], pictures: PressPictures) -> str:
    text = json.dumps([CACHE_FORMAT, ort.__version__, trunk.sha256, sorted(taps), pictures.sha256])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _open_entry(entry: Path) -> Taken | None:
    """An entry; None where there is none, or a file of it is incomplete."""
    try:
        grid = GridEntry.model_validate_json((entry / _GRID_FILE).read_bytes()).grid()
        return Taken(grid, {tap: np.load(entry / f"{tap}.npy", mmap_mode="r") for tap in grid.taps})
    except (OSError, ValueError):
        return None


def _write(
    folder: Path, trunk: Trunk, taps: Sequence[str], pictures: PressPictures, progress: Progress, threads: int
) -> None:
    """Write one .npy file per tap as a stream: a full disk is an error of a write, not of a memory map."""
    session = open_session(trunk.graph, threads, f"trunk '{trunk.id}'")
    grid = trunk_grid(session, tuple(sorted(taps)), pictures.view.shape, pictures.view.pixels_per_mm)
    with ExitStack() as stack:
        files = {tap: stack.enter_context((folder / f"{tap}.npy").open("wb")) for tap in grid.taps}
        for tap, file in files.items():
            np.lib.format.write_array_header_2_0(
                file, {"descr": "<f4", "fortran_order": False, "shape": (len(pictures), *grid.taps[tap])}
            )
        for start in range(0, len(pictures), _AT_ONCE):
            stop = min(start + _AT_ONCE, len(pictures))
            for tap, maps in extract(
                session, pictures.read(start, stop), grid, lambda fraction: None
            ).items():
                files[tap].write(np.ascontiguousarray(maps).data)
            progress(stop / len(pictures))
    (folder / _GRID_FILE).write_text(GridEntry.of(grid).model_dump_json())
