"""A limit learnt from nominal score maps, and the score map in units of it: 1 is the limit at every place.

With m a raw score map, D and U the two matrices of an axis that average over a window and interpolate back:

    contrast = m - U (D m)        for a kind with a window, else m
    limit    = U (middle + L * spread)
    map      = max(contrast / limit, m / guard)

middle and spread are the median and the scaled median deviation of the contrast over nominal presses, averaged over the
places nearby; without places the middle is 0 and the spread 1. L is the conformal limit of the largest
(contrast - middle) / spread of a nominal press, so a press fails where `map` exceeds 1 exactly where it exceeds L.

The surroundings hide damage that is as wide as the window. The guard keeps it: a raw value of GUARD times the plain
limit fails, whatever surrounds it.

All of it is float64 NumPy; `head_limit` writes the same into a head.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.limits.kinds import LimitKind
from plugins.detectors.common.smoothing import gaussian_matrix, upsampling_matrix

__all__ = ["GUARD", "MapLimit", "Spread", "Window", "learn_spread", "window"]

Float = NDArray[np.float64]
Maps = NDArray[np.floating]

GUARD = 1.1
"""Of the plain limit. Of 611 held-out sound presses, of simulated parts and real balls, 6 lie above the plain limit and
none above this; of the damaged ones above the plain limit six in seven do."""

PLACE_MM = 0.38
"""Median and spread are averaged over a window of this standard deviation: one and a half times the map's own blur."""

# A spread below the median spread is chance: places that no press touches would rule the limit.
_FLOOR = 1.0
# The median deviation of a normal distribution, to its standard deviation.
_NORMAL = 1.4826
# A place's limit is at least this share of the limits' median: contrast may be negative where a part has an edge.
_LEAST = 0.2


@dataclass(frozen=True, eq=False)
class Window:
    """Averages over a Gaussian window: float64 down (cells, pixels) and up (pixels, cells) of each axis."""

    down: tuple[Float, Float]
    up: tuple[Float, Float]

    def averaged(self, maps: Maps) -> Float:
        """The window's mean on a coarse grid: (n, rows, columns) of maps (n, h, w)."""
        return np.asarray(self.down[0] @ maps @ self.down[1].T, np.float64)

    def raised(self, grids: Float) -> Float:
        """Grids (n, rows, columns) interpolated to maps (n, h, w)."""
        return np.asarray(self.up[0] @ grids @ self.up[1].T, np.float64)


def window(sigma_mm: float, frame: tuple[int, int], pixels_per_mm: float) -> Window:
    """A window of this standard deviation over maps of (h, w); its cells are about as wide as that."""
    sigma = sigma_mm * pixels_per_mm
    axes = [(size, max(2, math.ceil(size / max(sigma, 1.0)))) for size in frame]
    up = [upsampling_matrix(cells, size) for size, cells in axes]
    down = [_sampled(gaussian_matrix(size, sigma), cells) for size, cells in axes]
    return Window((down[0], down[1]), (up[0], up[1]))


def _sampled(blur: Float, cells: int) -> Float:
    """A blur (pixels, pixels) at the middle of each cell, between two pixels where the middle lies there."""
    pixels = len(blur)
    middle = (np.arange(cells) + 0.5) * pixels / cells - 0.5
    low = np.floor(middle).astype(np.int64)
    share = (middle - low)[:, None]
    return np.asarray((1 - share) * blur[low] + share * blur[np.minimum(low + 1, pixels - 1)])


@dataclass(frozen=True, eq=False)
class Spread:
    """What nominal presses show at each place, before a limit is known. middle, spread: float64 (rows, columns)."""

    kind: LimitKind
    around: Window | None
    places: Window | None
    middle: Float
    spread: Float

    def contrast(self, maps: Maps) -> Float:
        """Float64 (n, h, w) of raw maps (n, h, w)."""
        if self.around is None:
            return np.asarray(maps, np.float64)
        return maps - self.around.raised(self.around.averaged(maps))

    def standardised(self, maps: Maps) -> Float:
        """The contrast in spreads above the middle, float64 (n, h, w)."""
        found = self.contrast(maps)
        if self.places is None:
            return found
        return np.asarray(
            (found - self.places.raised(self.middle[None])) / self.places.raised(self.spread[None])
        )

    def limited(self, limit: float, plain: float) -> "MapLimit":
        """With L and the plain limit. Errors: ValueError for limits that are not positive."""
        if not (limit > 0 and plain > 0):
            raise ValueError(f"limits are positive, found {limit} and {plain}")
        grid = self.middle + limit * self.spread
        return MapLimit(self, np.maximum(grid, _LEAST * float(np.median(grid))), GUARD * plain)


@dataclass(frozen=True, eq=False)
class MapLimit:
    """A limit for every place. grid: float64 (rows, columns), (1, 1) without places; guard: of raw values."""

    of: Spread
    grid: Float
    guard: float

    def relative(self, maps: Maps) -> Float:
        """Raw maps (n, h, w) in units of the limit, float64."""
        places = self.of.places
        limit = self.grid[None] if places is None else places.raised(self.grid[None])
        return np.asarray(np.maximum(self.of.contrast(maps) / limit, maps / self.guard), np.float64)


def learn_spread(kind: LimitKind, maps: Maps, pixels_per_mm: float) -> Spread:
    """From raw score maps (n, h, w) of nominal presses by banks without them."""
    frame = (maps.shape[1], maps.shape[2])
    around = None if kind.window_mm is None else window(kind.window_mm, frame, pixels_per_mm)
    one, none = np.ones((1, 1)), np.zeros((1, 1))
    free = Spread(kind, around, None, none, one)
    if not kind.is_by_place:
        return free
    found, places = free.contrast(maps), window(PLACE_MM, frame, pixels_per_mm)
    middle = np.median(found, axis=0)
    spread = _NORMAL * np.median(np.abs(found - middle), axis=0)
    middle, spread = (places.averaged(plane[None])[0] for plane in (middle, spread))
    least = max(_FLOOR * float(np.median(spread)), float(np.finfo(np.float32).tiny))
    return Spread(kind, around, places, middle, np.maximum(spread, least))
