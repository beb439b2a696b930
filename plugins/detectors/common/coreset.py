"""Greedy k-centre: a few rows that leave no other row far from its nearest chosen one.

Each pick is the row farthest from all earlier picks. Distances to the picks never rise, so an old value is an upper
bound. The lazy search computes only the rows whose bounds are above a level, which falls when no row is above it, and
chooses exactly the rows of the full search (Gonzalez 1985; the lazy rule is Minoux's).

Float64 throughout. Among equals the lowest row is picked, where rounding leaves them equal. Integers always stay equal;
of repeated rows of fractions any copy may be picked. The search ends early when every row equals a pick.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64

__all__ = ["Coreset", "k_centre"]

# A squared distance below this part of the two squared lengths is rounding of the product form, not a distance.
ROUNDING = 1e-13
# Rows updated together, and the part of the largest bound above which rows are updated next: the choice is the same
# with any. 1024 of 224,000 rows of 64 numbers take 1.0 s of one core, and 2.7 s with 256 rows from the largest down.
BATCH, STEP = 1024, 0.9


class Coreset(NamedTuple):
    """A few rows, picked by k-centre."""

    rows: NDArray[np.int64]
    """The rows in the order of picking, int64 (m,)."""
    radius: float
    """How far any row is from its nearest pick, plain distance."""


def k_centre(points: NDArray[np.floating], count: int, start: int, anchor: F64 | None = None) -> Coreset:
    """Choose at most `count` rows of `points` (n, c), beginning at `start`.

    anchor: (n,) plain distances, the first upper bounds (PatchCore's ten random points); the first pick is then the
    farthest by `anchor` instead of `start`.
    Errors: ValueError for no points, or a count or start out of range.
    """
    n = len(points)
    if not n or count < 1 or not 0 <= start < n:
        raise ValueError(
            f"a coreset needs points, a count and a start among them, found {n}, {count}, {start}"
        )
    x = np.ones((n, points.shape[1] + 1))
    # A row is subtracted and not the mean: integers stay integers, so that equal distances compare equal.
    np.subtract(points, points[start], out=x[:, :-1], dtype=np.float64)
    bound = np.full(n, np.inf) if anchor is None else np.square(anchor)
    picks = _Picks(x, bound, min(count, n))
    row = start if anchor is None else int(np.argmax(bound))
    while picks.count < len(picks.rows):
        picks.add(row)
        row = picks.farthest()
        if bound[row] <= 0:
            break
    return Coreset(picks.rows[: picks.count].copy(), float(np.sqrt(max(bound[row], 0.0))))


class _Picks:
    """The picks, and each row's upper bound of its squared distance to them: exact where `known` counts all picks.

    x: (n, c + 1), the last column 1, so that a product with (-2b, |b|^2) lacks |x|^2 alone. bound: (n,), first bounds.

    The front are the rows with bounds above a level, all exact; every other row is at or below the level.
    """

    def __init__(self, x: F64, bound: F64, most: int) -> None:
        self._x, self._bound = x, bound
        self._lengths = np.einsum("nc,nc->n", x[:, :-1], x[:, :-1])
        self._known = np.zeros(len(x), np.int64)
        self._front, self._level = np.empty(0, np.int64), np.inf
        self.rows, self.count = np.empty(most, np.int64), 0
        self._picked = np.empty((most, x.shape[1]))

    def add(self, row: int) -> None:
        self.rows[self.count] = row
        self._picked[self.count] = -2 * self._x[row]
        self._picked[self.count, -1] = self._lengths[row]
        self.count += 1
        self._measure(self._front if self.count > 1 else np.arange(len(self._x)))

    def farthest(self) -> int:
        """The lowest row with the largest distance to the picks; only rows that might be it are updated."""
        while True:
            bounds = self._bound[self._front]
            if len(bounds) and bounds.max() > self._level:
                return int(self._front[bounds.argmax()])
            top = self._bound.max()
            if top <= 0:
                return int(self._bound.argmax())
            self._level = STEP * min(self._level, top)
            rows = np.flatnonzero(self._bound > self._level)
            self._measure(rows)
            self._front = rows[self._bound[rows] > self._level]

    def _measure(self, rows: NDArray[np.int64]) -> None:
        """Lower the bounds of `rows` by the picks that they have not been compared with."""
        known = self._known[rows]
        for count in np.unique(known[known < self.count]):
            stale = rows[known == count]
            for first in range(0, len(stale), BATCH):
                part = stale[first : first + BATCH]
                self._bound[part] = np.minimum(
                    self._bound[part], self._nearest(part, slice(count, self.count))
                )
        self._known[rows] = self.count

    def _nearest(self, rows: NDArray[np.int64], picks: slice) -> F64:
        """The smallest squared distance of each row to some picks; what is rounding is zero."""
        x, lengths, picked = self._x[rows], self._lengths[rows], self._picked[picks]
        nearest: F64 = (picked @ x.T).min(axis=0) + lengths
        near = np.flatnonzero(nearest <= ROUNDING * (lengths + picked[:, -1].max()))
        squared = picked @ x[near].T + lengths[near]
        squared[squared <= ROUNDING * (lengths[near] + picked[:, -1:])] = 0.0
        nearest[near] = squared.min(axis=0)
        return nearest
