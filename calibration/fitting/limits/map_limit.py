"""A limit learnt from nominal score maps, and the score map in units of it: 1 is the limit at every place.

With m a raw score map, D and U the two matrices of an axis that average over a window and interpolate back:

    contrast = m - U (D m)        for `surroundings`, else m
    limit    = U (middle + L * spread)
    map      = max(contrast / limit, m / guard)

middle and spread are the median and the scaled median deviation of m over nominal presses, averaged over the places
nearby; where places are not compared the middle is 0 and the spread 1. L is the conformal limit of the largest
(contrast - middle) / spread of a nominal press, so a press fails where `map` exceeds 1 exactly where it exceeds L.

The surroundings hide damage that is as wide as the window. The guard keeps it: a raw value of GUARD times the plain
limit fails, whatever surrounds it.

All of it is float64 NumPy; `appended` writes the same into a head.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plugins.detectors.common.smoothing import gaussian_matrix, upsampling_matrix

__all__ = ["GUARD", "KINDS", "PLACES", "PLAIN", "SURROUNDINGS", "Limit", "Spread", "learn_spread", "relate"]

Float = NDArray[np.float64]
Maps = NDArray[np.floating]

Limit = Mapping[str, Float]
"""A limit as the arrays of a bank. Columns are transposed: they multiply from the right."""

PLAIN, PLACES, SURROUNDINGS = "plain", "places", "surroundings"

KINDS: Mapping[str, str] = {
    PLAIN: "one limit for all places",
    PLACES: "the range of nominal presses at the same place",
    SURROUNDINGS: "its surroundings (0.5 mm)",
}
"""What a score map is compared with, by the kind of limit, in the order in which kinds are preferred where they find
equally much."""

GUARD = 1.1
"""Of the plain limit. Of 611 held-out sound presses, of simulated parts and real balls, 6 lie above the plain limit and
none above this; of the damaged ones above the plain limit six in seven do."""

# Standard deviation of the surroundings, chosen on the development set of real touch: most of a smooth difference
# between two presses is gone and an edit of 1 mm is not.
_WINDOW_MM = 0.5
# Median and spread are averaged over a window of this standard deviation: one and a half times the map's own blur.
_PLACE_MM = 0.38
# A spread below the median spread is chance: places that no press touches would rule the limit.
_FLOOR = 1.0
# The median deviation of a normal distribution, to its standard deviation.
_NORMAL = 1.4826
# A place's limit is at least this share of the limits' median: contrast may be negative where a part has an edge.
_LEAST = 0.2


@dataclass(frozen=True, eq=False)
class Spread:
    """What nominal presses show at each place, before a limit is known."""

    arrays: Limit
    """The window or the places."""
    middle: Float
    spread: Float
    """Middle and spread of each cell, float64 (rows, columns)."""

    def standardise(self, maps: Maps) -> Float:
        """Return the contrast of raw maps (n, h, w) in spreads above the middle, float64."""
        middle, spread = (_interpolate(self.arrays, grid) for grid in (self.middle, self.spread))
        return np.asarray((_contrast(self.arrays, maps) - middle) / spread, np.float64)

    def limit(self, limit: float, plain: float) -> Limit:
        """Make the limit of L and the plain limit. Errors: ValueError for limits that are not positive."""
        if not (limit > 0 and plain > 0):
            raise ValueError(f"limits are positive, found {limit} and {plain}")
        grid = self.middle + limit * self.spread
        grid = np.maximum(grid, _LEAST * float(np.median(grid)))
        return {"limit_grid": grid, "limit_guard": np.full((1, 1), GUARD * plain), **self.arrays}


def learn_spread(
    kind: str, maps: Maps, pixels_per_mm: float, seen: NDArray[np.bool_] | None = None
) -> Spread:
    """Learn the spread from raw score maps (n, h, w) of nominal presses by banks without them.

    seen: the places of each that count, bool (n, h, w); None for all.
    """
    if kind != PLACES:
        window = _window(_WINDOW_MM * pixels_per_mm, maps.shape[1:])
        (down_rows, up_rows), (down_columns, up_columns) = window
        arrays = {
            "limit_window_down_rows": down_rows,
            "limit_window_down_columns": down_columns.T,
            "limit_window_up_rows": up_rows,
            "limit_window_up_columns": up_columns.T,
        }
        return Spread(arrays, np.zeros((1, 1)), np.ones((1, 1)))
    (down_rows, up_rows), (down_columns, up_columns) = _window(_PLACE_MM * pixels_per_mm, maps.shape[1:])
    middle = _median(maps, seen)
    spread = _NORMAL * _median(np.abs(maps - middle), seen)
    middle, spread = (down_rows @ plane @ down_columns.T for plane in (middle, spread))
    least = max(_FLOOR * float(np.median(spread)), float(np.finfo(np.float32).tiny))
    return Spread({"limit_rows": up_rows, "limit_columns": up_columns.T}, middle, np.maximum(spread, least))


def _median(maps: Maps, seen: NDArray[np.bool_] | None) -> Float:
    """Return the median over presses at each place, (h, w), of those that show it; 0 where none does."""
    if seen is None:
        return np.asarray(np.median(maps, axis=0))
    ordered, count = np.sort(np.where(seen, maps, np.inf), axis=0), seen.sum(axis=0)
    ends = [
        np.take_along_axis(ordered, np.maximum(at, 0)[None], axis=0)[0]
        for at in ((count - 1) // 2, count // 2 - (count == 0))
    ]
    return np.where(
        count > 0, 0.5 * np.where(count > 0, ends[0], 0) + 0.5 * np.where(count > 0, ends[1], 0), 0
    )


def relate(limit: Limit, maps: Maps) -> Float:
    """Return raw maps (n, h, w) in units of the limit, float64."""
    relative = _contrast(limit, maps) / _interpolate(limit, limit["limit_grid"])
    return np.asarray(np.maximum(relative, maps / limit["limit_guard"]), np.float64)


def _contrast(limit: Limit, maps: Maps) -> Float:
    """Subtract the surroundings from raw maps, where the limit has a window."""
    raw = np.asarray(maps, np.float64)
    if "limit_window_up_rows" not in limit:
        return raw
    averaged = limit["limit_window_down_rows"] @ raw @ limit["limit_window_down_columns"]
    return np.asarray(raw - limit["limit_window_up_rows"] @ averaged @ limit["limit_window_up_columns"])


def _interpolate(limit: Limit, grid: Float) -> Float:
    """Interpolate the cells of the places to pixels; one cell stands for all of them."""
    return limit["limit_rows"] @ grid @ limit["limit_columns"] if "limit_rows" in limit else grid


def _window(sigma: float, frame: tuple[int, ...]) -> list[tuple[Float, Float]]:
    """Make a Gaussian window over maps of (h, w), whose cells are about as wide as its standard deviation in pixels.

    For each axis the matrices that average, (cells, pixels), and that interpolate, (pixels, cells).
    """
    axes = [(size, max(2, math.ceil(size / max(sigma, 1.0)))) for size in frame]
    return [
        (_sample_middles(gaussian_matrix(size, sigma), cells), upsampling_matrix(cells, size))
        for size, cells in axes
    ]


def _sample_middles(blur: Float, cells: int) -> Float:
    """Sample a blur (pixels, pixels) at the middle of each cell, between two pixels where the middle lies there."""
    pixels = len(blur)
    middle = (np.arange(cells) + 0.5) * pixels / cells - 0.5
    low = np.floor(middle).astype(np.int64)
    share = (middle - low)[:, None]
    return np.asarray((1 - share) * blur[low] + share * blur[np.minimum(low + 1, pixels - 1)])
