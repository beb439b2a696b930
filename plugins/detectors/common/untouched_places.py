"""Places that no nominal press touches: one row each, the untouched gel, instead of rows of every press.

Presses and frames without contact show the free gel there. A press is compared with its mean, in the same features and
by the same plain distance as elsewhere. So a touch in the wrong place has a high score like any other defect. Where the
free gel itself varies (noise, drift of the light) its distances are lowered: nominal ones are then not above those of
touched places.
"""

import math

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, Mask
from edge.core.detector import Grid, Nominal
from plugins.detectors.common.embedding import require_touched, touched_cells
from plugins.detectors.common.tile_layout import layout, split
from plugins.onnx_builder import Graph, Value

__all__ = ["emit_gel_distances", "gel_distances", "gel_mean", "gel_weight", "touched_places"]

# The free gel's nominal distances are scaled until this quantile of them is below the touched places' median.
QUANTILE = 0.99
# Places whose scatter is measured at once: bounds the memory at BLOCK * presses * channels float64 numbers.
BLOCK = 512


def touched_places(nominal: Nominal, grid: Grid, cells: tuple[int, int], margin_mm: float) -> Mask:
    """Which cells see a touched pixel within the margin, flat bool (tiles * h * w,), tile by tile.

    cells: (h, w) of one tile. All of them where the touch is not known. Errors: FitError for none.
    """
    (down, across), (h, w) = layout(grid), cells
    touched = require_touched(touched_cells(nominal, grid, (down * h, across * w), margin_mm))
    tiles = split(touched.reshape(1, 1, down * h, across * w).astype(np.float32), grid)
    return tiles.ravel() > 0


def gel_mean(pressed: NDArray[np.floating], free: NDArray[np.floating] | None) -> tuple[F32, float]:
    """The mean gel float32 (places, c), and how far nominal frames lie from the mean of the others (a high quantile).

    pressed: (n, places, c) of the nominal presses at untouched places. free: (m, places, c) of frames without contact.
    The distance is nan where there is only one frame.
    """
    frames = pressed if free is None else np.concatenate([pressed, free])
    n, places, c = frames.shape
    mean, distances = np.empty((places, c), np.float32), np.empty((n, places))
    for first in range(0, places, BLOCK):
        part = slice(first, first + BLOCK)
        x = frames[:, part].astype(np.float64)
        mean[part] = x.mean(axis=0)
        x -= x.mean(axis=0)
        distances[:, part] = np.sqrt(np.einsum("npc,npc->np", x, x))
    if n < 2 or not places:
        return mean, math.nan
    # A frame's distance to the mean of all is (n - 1) / n of its distance to the mean of the others.
    return mean, float(np.quantile(distances, QUANTILE)) * n / (n - 1)


def gel_weight(scatter: float, nominal: float) -> float:
    """The factor of the free gel's distances: at most 1, and 1 where the scatter is not known.

    scatter: from `gel_mean`. nominal: the median distance of nominal presses to each other where they touch.
    """
    is_known = math.isfinite(scatter) and math.isfinite(nominal) and nominal > 0
    return min(1.0, nominal / scatter) if is_known and scatter > 0 else 1.0


def gel_distances(
    rows: NDArray[np.floating], mean: NDArray[np.floating], weight: NDArray[np.floating]
) -> F64:
    """The oracle: weighted distances (n, places) of rows (n, places, c) from the free gel (places, c)."""
    difference = rows.astype(np.float64) - mean
    distances: F64 = np.sqrt(np.einsum("npc,npc->np", difference, difference))
    return distances * weight.astype(np.float64)


def emit_gel_distances(graph: Graph, rows: Value, mean: Value, weight: Value) -> Value:
    """Give the same distances in a graph."""
    difference = graph.op("Sub", rows, mean)
    squared = graph.op("ReduceSumSquare", difference, graph.ints(2), keepdims=0)
    return graph.op("Mul", graph.op("Sqrt", squared), weight)
