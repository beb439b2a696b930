"""Feature maps of many frames, from the trunk alone, and what in them hides damage."""

import tempfile
from collections.abc import Sequence

import numpy as np
import onnxruntime as ort

from edge.core.arrays import F32, F64, U8, Mask
from edge.core.detector import Features, Grid, Nominal, Progress
from edge.core.errors import FitError
from edge.core.imaging.tiles import TILES_KEY, Tiles
from edge.model.session import RUNTIME_ERRORS
from edge.model.tile_runner import TiledMaps, TileRunner
from plugins.detectors.common.embedding import DEVIATION_FLOOR, touched_cells

__all__ = ["extract", "feature_warnings", "trunk_grid"]

# A batch costs as much per frame as a single one on two cores; four keeps the progress bar moving and memory small.
BATCH = 4

# One channel with more than this share of a tap's variance hides the others. Measured with corrected PaDiM: at 96 %
# damage in them stands out by 2.4 times a fresh press in place of 2.6, at 99 % by 1.6, at 99.9 % not at all. On the
# shipped trunks the largest share is 11 %.
MOST_OF_ONE_CHANNEL = 0.9

# Above this the maps of all presses are in a temporary file: 100 presses of 1280x720 on Wide-ResNet-50-2 are 10 GB.
MEMORY_BYTES = 1 << 30


def trunk_grid(
    session: ort.InferenceSession, taps: Sequence[str], frame: tuple[int, int], pixels_per_mm: float
) -> Grid:
    """The geometry of the taps for frames of (h, w), found by running the trunk once.

    Errors: FitError for a tap that the trunk lacks, or a frame that it cannot take.
    """
    tiles = _tiles(session, frame)
    given = [output.name for output in session.get_outputs()]
    missing = [tap for tap in taps if tap not in given]
    if missing:
        raise FitError(
            f"the detector reads {', '.join(taps)}, the trunk gives {', '.join(given)}; export a trunk with "
            f"{', '.join(missing)}"
        )
    down, across, seen = (1, 1, frame)
    if tiles is not None:
        down, across, seen = len(tiles.rows), len(tiles.columns), (tiles.size, tiles.size)
    maps = _run(session, list(taps), np.full((1, *seen, 3), 128, np.uint8))
    shapes = {
        tap: (m.shape[1], m.shape[2] * down, m.shape[3] * across) for tap, m in zip(taps, maps, strict=True)
    }
    return Grid(frame, shapes, pixels_per_mm, tiles)


def _tiles(session: ort.InferenceSession, frame: tuple[int, int]) -> Tiles | None:
    """The layout of a trunk that sees its frame in tiles; None for one without tiles. Errors: FitError."""
    written = session.get_modelmeta().custom_metadata_map.get(TILES_KEY)
    if written is None:
        return None
    tiles = Tiles.read(written)
    if tiles.frame != frame:
        raise FitError(
            f"the trunk is tiled for frames of {tiles.frame} (h, w), the region is {frame}; give the region that size, "
            "or tile the trunk again with `gelgate export tiles`"
        )
    return tiles


def extract(
    session: ort.InferenceSession,
    frames: U8,
    grid: Grid,
    progress: Progress,
    memory_bytes: int = MEMORY_BYTES,
) -> Features:
    """Tap name to float32 (n, c, h, w) for all frames, uint8 (n, h, w, 3).

    A tap of more than memory_bytes is in a temporary file. Errors: FitError, non-finite features.
    """
    taps = list(grid.taps)
    features = {tap: _room((len(frames), *grid.taps[tap]), memory_bytes) for tap in taps}
    size = BATCH if grid.tiles is None else 1
    runner = None if grid.tiles is None else TileRunner(session, grid.tiles, grid.taps)
    for start in range(0, len(frames), size):
        batch = frames[start : start + size]
        batch_maps = _run(session, taps, batch) if runner is None else _of_tiles(runner, batch[0])
        for tap, maps in zip(taps, batch_maps, strict=True):
            if not np.isfinite(maps).all():
                raise FitError(f"the trunk gives features that are not finite at {tap}; use another backbone")
            features[tap][start : start + size] = maps
        progress(min(1.0, (start + size) / len(frames)))
    return features


def feature_warnings(nominal: Nominal, grid: Grid) -> list[str]:
    """Which taps can hide damage from any method: one that hardly differs between presses, or in one channel alone."""
    if nominal.presses == 1:
        return []
    sentences = []
    for tap, maps in nominal.features.items():
        cells = touched_cells(nominal, grid, (maps.shape[2], maps.shape[3]), 0.0)
        power, variance = _spread(maps.reshape(*maps.shape[:2], -1), cells)
        total, widest = float(variance.sum()), int(variance.argmax())
        if total < DEVIATION_FLOOR**2 * power:
            sentences.append(
                f"'{tap}' differs between nominal presses by less than {DEVIATION_FLOOR:.0%} of its size: fainter "
                "differences are missed; give presses that differ, or use another trunk"
            )
        elif variance[widest] > MOST_OF_ONE_CHANNEL * total:
            sentences.append(
                f"channel {widest} of '{tap}' has more than {MOST_OF_ONE_CHANNEL:.0%} of what differs between nominal "
                f"presses: damage that the other {len(variance) - 1} channels show may be missed; use another trunk"
            )
    return sentences


def _spread(maps: F32, cells: Mask) -> tuple[float, F64]:
    """Sum over channels of mean squares, and each channel's mean variance between presses, (c,), both relative to the
    largest value. maps: (n, c, cells). cells: those that count."""
    top = max(float(maps.max()), -float(maps.min())) or 1.0
    power, variance = 0.0, np.zeros(maps.shape[1])
    for channel in range(maps.shape[1] if cells.any() else 0):
        values = maps[:, channel, cells].astype(np.float64) / top
        power += float(np.square(values).mean())
        variance[channel] = values.var(axis=0, ddof=1).mean()
    return power, variance


def _of_tiles(runner: TileRunner, frame: U8) -> list[F32]:
    """The mosaics (1, c, h, w) of one frame, every tile run."""
    mosaics = TiledMaps(runner, 1)
    try:
        mosaics.show(frame[None])
    except RUNTIME_ERRORS as error:
        raise FitError(f"the trunk does not run on its tiles: {error!s:.200}") from error
    return list(mosaics.arrays.values())


def _room(shape: tuple[int, ...], memory_bytes: int) -> F32:
    """An empty array; a large one is in a file that is deleted with it."""
    if 4 * int(np.prod(shape)) <= memory_bytes:
        return np.empty(shape, np.float32)
    with tempfile.TemporaryFile(prefix="gelgate-features-") as file:
        return np.memmap(file, np.float32, "w+", shape=shape)


def _run(session: ort.InferenceSession, taps: list[str], frames: U8) -> list[F32]:
    try:
        return list(session.run(taps, {"frames": frames}))
    except RUNTIME_ERRORS as error:
        raise FitError(
            f"the trunk does not run on frames of {frames.shape[1:3]} (h, w): {error!s:.200}"
        ) from error
