"""Greedy k-centre: a few rows that leave no other row far from its nearest chosen one.

Each pick is the row farthest from all earlier picks. Distances to the picks never rise, so an old value is an upper
bound. The lazy search computes only the rows that could still be the farthest, and chooses exactly the rows of the full
search (Gonzalez 1985; the lazy rule is Minoux's).

Float64 throughout. Among equals the lowest row is picked, where rounding leaves them equal. Integers always stay equal;
of repeated rows of fractions any copy may be picked. The search ends early when every row equals a pick.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Coreset", "greedy_from_distances", "k_centre"]

# A squared distance below this part of the two squared lengths is rounding of the product form, not a distance.
ROUNDING = 1e-13
# Rows updated together, and rows among which the farthest is searched until a row outside might be farther: the choice
# is the same with any. 1024 of 180,000 rows of 64 numbers took 3.4 s with 128 and 2048, 2.6 s with these.
BATCH, POOL = 256, 8192


class Coreset(NamedTuple):
    """rows: int64 (m,), in the order of picking. radius: how far any row is from its nearest pick, plain distance."""

    rows: NDArray[np.int64]
    radius: float


def k_centre(
    points: NDArray[np.floating], count: int, start: int, anchor: NDArray[np.float64] | None = None
) -> Coreset:
    """At most `count` rows of `points` (n, c), beginning at `start`.

    anchor: (n,) plain distances, the first upper bounds (PatchCore's ten random points); the first pick is then the
    farthest by `anchor` instead of `start`.
    Errors: ValueError for no points, or a count or start out of range.
    """
    n = len(points)
    if not n or count < 1 or not 0 <= start < n:
        raise ValueError(
            f"a coreset needs points, a count and a start among them, found {n}, {count}, {start}"
        )
    x = points.astype(np.float64)
    x -= x[start]  # a row and not the mean: integers stay integers, so that equal distances compare equal
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
    """The picks, and each row's upper bound of its squared distance to them: exact where `known` counts all picks."""

    def __init__(self, x: NDArray[np.float64], bound: NDArray[np.float64], most: int) -> None:
        self._x, self._bound = x, bound
        self._lengths = np.einsum("nc,nc->n", x, x)
        self._known = np.zeros(len(x), np.int64)
        # The numbers, rising, of the rows with the largest bounds, and the largest bound of the others.
        self._pool, self._outside = np.arange(min(POOL, len(x))), np.inf
        self.rows, self.count = np.empty(most, np.int64), 0
        # Contiguous copies: every product reads all of them.
        self._picked, self._picked_lengths = np.empty((most, x.shape[1])), np.empty(most)

    def add(self, row: int) -> None:
        self.rows[self.count] = row
        self._picked[self.count], self._picked_lengths[self.count] = self._x[row], self._lengths[row]
        self.count += 1
        if self.count == 1:
            self._measure(np.arange(len(self._x)))

    def farthest(self) -> int:
        """The row with the largest distance to the picks; only rows that might be it are updated."""
        while True:
            row = self._highest()
            if self._known[row] == self.count or self._bound[row] <= 0:
                return row
            bounds = self._bound[self._pool]
            batch = min(BATCH, len(bounds))
            stale = self._pool[np.argpartition(bounds, len(bounds) - batch)[len(bounds) - batch :]]
            stale = stale[self._known[stale] < self.count]
            self._measure(np.union1d(stale, row))

    def _highest(self) -> int:
        """The lowest row of those with the largest bound. The pool has it as long as no row outside can equal it."""
        row = int(self._pool[self._bound[self._pool].argmax()])
        if self._bound[row] > self._outside:
            return row
        if self._bound[row] == self._outside:
            return int(self._bound.argmax())
        ranked = np.argpartition(self._bound, len(self._bound) - len(self._pool))
        others = ranked[: len(self._bound) - len(self._pool)]
        self._pool = np.sort(ranked[len(others) :])
        self._outside = self._bound[others].max() if len(others) else -np.inf
        return int(self._bound.argmax())

    def _measure(self, rows: NDArray[np.int64]) -> None:
        """Lower the bounds of `rows` by every pick that one of them has not been compared with."""
        unseen = slice(int(self._known[rows].min()), self.count)
        both = self._lengths[rows, None] + self._picked_lengths[unseen]
        squared = both - 2 * (self._x[rows] @ self._picked[unseen].T)
        squared[squared <= ROUNDING * both] = 0.0
        self._bound[rows] = np.minimum(self._bound[rows], squared.min(axis=1))
        self._known[rows] = self.count


def greedy_from_distances(squared: NDArray[np.floating], count: int, start: int) -> NDArray[np.int64]:
    """The same choice for many small sets at once, from pairwise squared distances (g, n, n): int64 rows (g, count).

    No row is picked twice; where all remaining rows equal a pick, the lowest of them follows.
    """
    groups, n = squared.shape[:2]
    rows = np.empty((groups, min(count, n)), np.int64)
    rows[:, 0] = start
    every = np.arange(groups)
    bound = squared[:, start].astype(np.float64)
    bound[:, start] = -1.0
    for size in range(1, rows.shape[1]):
        rows[:, size] = bound.argmax(axis=1)
        np.minimum(bound, squared[every, rows[:, size]], out=bound)
        bound[every, rows[:, size]] = -1.0
    return rows
