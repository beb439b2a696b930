"""The limit by surroundings: the score map in units of it, 1 at the limit of every place.

With m a raw score map, D and U the two matrices of an axis that average over a window and interpolate back, usual
USUAL_SHARE of the mean of nominal maps:

    contrast = m / (max(U (D m), 0) + usual)
    map      = max(contrast / L, m / guard)

L is the conformal limit of the largest contrast of a nominal press, so a press fails where `map` exceeds 1 exactly
where its contrast exceeds L. What makes a map high in a wide area, a pose that is a little wrong or another depth, also
makes it uneven there, in proportion: so it is divided, not subtracted.

The surroundings hide damage that is as wide as the window. The guard keeps it: a raw value of GUARD times the plain
limit fails, whatever surrounds it.

All of it is float64 NumPy; `appended` writes the same into a head.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64
from plugins.detectors.common.smoothing import gaussian_matrix, upsampling_matrix

__all__ = [
    "GUARD",
    "PLAIN",
    "SURROUNDINGS",
    "WINDOW_MM",
    "Limit",
    "find_contrast",
    "make_limit",
    "make_window",
    "relate",
]

Maps = NDArray[np.floating]

Limit = Mapping[str, F64]
"""A limit as the arrays of a bank. Columns are transposed: they multiply from the right."""

PLAIN, SURROUNDINGS = "plain", "surroundings"

GUARD = 1.1
"""Of the plain limit. Of 611 held-out sound presses, of simulated parts and real balls, 6 lie above the plain limit and
none above this; of the damaged ones above the plain limit six in seven do."""

# Standard deviation of the surroundings, and what is added to them so that a faint speck on faint ground is nothing.
# Chosen on 13 kinds of presses: 0.5 to 1 mm, and shares of 0.5 to 2, report 0.82 to 0.84 of the damage.
WINDOW_MM = 0.75
USUAL_SHARE = 0.5


def make_window(nominal: Maps, pixels_per_mm: float) -> Limit:
    """Make the window of the surroundings over maps like these of nominal presses, (n, h, w)."""
    frame = nominal.shape[1:]
    (down_rows, up_rows), (down_columns, up_columns) = _window(WINDOW_MM * pixels_per_mm, frame)
    return {
        "limit_window_down_rows": down_rows,
        "limit_window_down_columns": down_columns.T,
        "limit_window_up_rows": up_rows,
        "limit_window_up_columns": up_columns.T,
        "limit_usual": np.full((1, 1), USUAL_SHARE * nominal.mean(dtype=np.float64)),
    }


def make_limit(window: Limit, limit: float, plain: float) -> Limit:
    """Make the limit of L and the plain limit, which are positive."""
    return {"limit_grid": np.full((1, 1), limit), "limit_guard": np.full((1, 1), GUARD * plain), **window}


def relate(limit: Limit, maps: Maps) -> F64:
    """Return raw maps (n, h, w) in units of the limit, float64."""
    relative = find_contrast(limit, maps) / limit["limit_grid"]
    return np.asarray(np.maximum(relative, maps / limit["limit_guard"]), np.float64)


def find_contrast(limit: Limit, maps: Maps) -> F64:
    """Divide raw maps by their surroundings."""
    raw = np.asarray(maps, np.float64)
    averaged = limit["limit_window_down_rows"] @ raw @ limit["limit_window_down_columns"]
    around = limit["limit_window_up_rows"] @ averaged @ limit["limit_window_up_columns"]
    return np.asarray(raw / (np.maximum(around, 0) + limit["limit_usual"]))


def _window(sigma: float, frame: tuple[int, ...]) -> list[tuple[F64, F64]]:
    """Make a Gaussian window over maps of (h, w), whose cells are about as wide as its standard deviation in pixels.

    For each axis the matrices that average, (cells, pixels), and that interpolate, (pixels, cells).
    """
    axes = [(size, max(2, math.ceil(size / max(sigma, 1.0)))) for size in frame]
    return [
        (_sample_middles(gaussian_matrix(size, sigma), cells), upsampling_matrix(cells, size))
        for size, cells in axes
    ]


def _sample_middles(blur: F64, cells: int) -> F64:
    """Sample a blur (pixels, pixels) at the middle of each cell, between two pixels where the middle lies there."""
    pixels = len(blur)
    middle = (np.arange(cells) + 0.5) * pixels / cells - 0.5
    low = np.floor(middle).astype(np.int64)
    share = (middle - low)[:, None]
    return np.asarray((1 - share) * blur[low] + share * blur[np.minimum(low + 1, pixels - 1)])
