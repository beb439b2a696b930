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

from plugins.detectors.common.smoothing import gaussian_matrix, upsampling_matrix

__all__ = ["GUARD", "KINDS", "PLAIN", "LimitKind", "MapLimit", "Spread", "Window", "learn_spread", "window"]

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


@dataclass(frozen=True)
class LimitKind:
    """How a score map is compared."""

    name: str
    about: str
    """What the map is compared with, in words."""
    window_mm: float | None = None
    """The standard deviation of the Gaussian window whose mean is subtracted from each value; None: nothing is."""
    is_by_place: bool = False
    """Whether each place has its own limit, from the median and the spread of the nominal presses there."""


PLAIN = LimitKind("plain", "one limit for all places")

# Windows are chosen on the development set of real touch: at 0.5 mm most of a smooth difference between two presses is
# gone and an edit of 1 mm is not; the wide one keeps more of wide damage.
KINDS = (
    PLAIN,
    LimitKind("places", "the range of nominal presses at the same place", is_by_place=True),
    LimitKind("surroundings", "its surroundings (0.5 mm)", 0.5),
    LimitKind("wide surroundings", "its surroundings (1.25 mm)", 1.25),
    LimitKind("surroundings by place", "its surroundings (0.5 mm), by place", 0.5, True),
    LimitKind("wide surroundings by place", "its surroundings (1.25 mm), by place", 1.25, True),
)
"""Every kind, in the order in which they are preferred where they find equally much."""


@dataclass(frozen=True, eq=False)
class Window:
    """Averages over a Gaussian window: float64 down (cells, pixels) and up (pixels, cells) of each axis."""

    down: tuple[Float, Float]
    up: tuple[Float, Float]

    def average(self, maps: Maps) -> Float:
        """Return the window's mean on a coarse grid: (n, rows, columns) of maps (n, h, w)."""
        return np.asarray(self.down[0] @ maps @ self.down[1].T, np.float64)

    def interpolate(self, grids: Float) -> Float:
        """Interpolate grids (n, rows, columns) to maps (n, h, w)."""
        return np.asarray(self.up[0] @ grids @ self.up[1].T, np.float64)


def window(sigma_mm: float, frame: tuple[int, int], pixels_per_mm: float) -> Window:
    """Make a window of this standard deviation over maps of (h, w); its cells are about as wide as that."""
    sigma = sigma_mm * pixels_per_mm
    axes = [(size, max(2, math.ceil(size / max(sigma, 1.0)))) for size in frame]
    up = [upsampling_matrix(cells, size) for size, cells in axes]
    down = [_sample_middles(gaussian_matrix(size, sigma), cells) for size, cells in axes]
    return Window((down[0], down[1]), (up[0], up[1]))


def _sample_middles(blur: Float, cells: int) -> Float:
    """Sample a blur (pixels, pixels) at the middle of each cell, between two pixels where the middle lies there."""
    pixels = len(blur)
    middle = (np.arange(cells) + 0.5) * pixels / cells - 0.5
    low = np.floor(middle).astype(np.int64)
    share = (middle - low)[:, None]
    return np.asarray((1 - share) * blur[low] + share * blur[np.minimum(low + 1, pixels - 1)])


@dataclass(frozen=True, eq=False)
class Spread:
    """What nominal presses show at each place, before a limit is known."""

    kind: LimitKind
    around: Window | None
    places: Window | None
    middle: Float
    spread: Float
    """Middle and spread of each cell, float64 (rows, columns)."""

    def contrast(self, maps: Maps) -> Float:
        """Subtract the surroundings from raw maps (n, h, w), float64."""
        if self.around is None:
            return np.asarray(maps, np.float64)
        return maps - self.around.interpolate(self.around.average(maps))

    def standardise(self, maps: Maps) -> Float:
        """Return the contrast in spreads above the middle, float64 (n, h, w)."""
        found = self.contrast(maps)
        if self.places is None:
            return found
        return np.asarray(
            (found - self.places.interpolate(self.middle[None])) / self.places.interpolate(self.spread[None])
        )

    def limit(self, limit: float, plain: float) -> "MapLimit":
        """Make the limit of L and the plain limit. Errors: ValueError for limits that are not positive."""
        if not (limit > 0 and plain > 0):
            raise ValueError(f"limits are positive, found {limit} and {plain}")
        grid = self.middle + limit * self.spread
        return MapLimit(self, np.maximum(grid, _LEAST * float(np.median(grid))), GUARD * plain)


@dataclass(frozen=True, eq=False)
class MapLimit:
    """A limit for every place."""

    of: Spread
    grid: Float
    """The limit of each cell, float64 (rows, columns); (1, 1) without places."""
    guard: float
    """A raw value above this fails, whatever surrounds it."""

    def relate(self, maps: Maps) -> Float:
        """Return raw maps (n, h, w) in units of the limit, float64."""
        places = self.of.places
        limit = self.grid[None] if places is None else places.interpolate(self.grid[None])
        return np.asarray(np.maximum(self.of.contrast(maps) / limit, maps / self.guard), np.float64)


def learn_spread(kind: LimitKind, maps: Maps, pixels_per_mm: float) -> Spread:
    """Learn the spread from raw score maps (n, h, w) of nominal presses by banks without them."""
    frame = (maps.shape[1], maps.shape[2])
    around = None if kind.window_mm is None else window(kind.window_mm, frame, pixels_per_mm)
    one, none = np.ones((1, 1)), np.zeros((1, 1))
    free = Spread(kind, around, None, none, one)
    if not kind.is_by_place:
        return free
    found, places = free.contrast(maps), window(PLACE_MM, frame, pixels_per_mm)
    middle = np.median(found, axis=0)
    spread = _NORMAL * np.median(np.abs(found - middle), axis=0)
    middle, spread = (places.average(plane[None])[0] for plane in (middle, spread))
    least = max(_FLOOR * float(np.median(spread)), float(np.finfo(np.float32).tiny))
    return Spread(kind, around, places, middle, np.maximum(spread, least))
