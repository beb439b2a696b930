"""Greedy k-centre: a few rows that leave no other row far from its nearest chosen one.

Each pick is the row farthest from everything picked before. Distances to the picks only ever fall, so a value that was
not brought up to date is an upper bound: the lazy search measures only the rows that could still be the farthest, and
chooses exactly what the full search chooses (Gonzalez 1985; the lazy rule is Minoux's).

Float64 throughout. Among equals the lowest row is picked; the search ends early when every row is at a pick.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Coreset", "greedy_from_distances", "k_centre"]

# A squared distance below this part of the two squared lengths is rounding of the product form, not a distance.
ROUNDING = 1e-13
# Rows brought up to date together.
BATCH = 64


class Coreset(NamedTuple):
    """rows: int64 (m,), in the order of picking. radius: how far any row is from its nearest pick, plain distance."""

    rows: NDArray[np.int64]
    radius: float


def k_centre(
    points: NDArray[np.floating], count: int, start: int, anchor: NDArray[np.float64] | None = None
) -> Coreset:
    """At most `count` rows of `points` (n, c), beginning at `start`.

    anchor: (n,) plain distances that bound the first values from above (PatchCore's ten random points); `start` is
    then not picked by itself and the first pick is the farthest by `anchor`.
    Errors: ValueError for no points, or a count or start out of range.
    """
    n = len(points)
    if not n or count < 1 or not 0 <= start < n:
        raise ValueError(
            f"a coreset needs points, a count and a start among them, found {n}, {count}, {start}"
        )
    x = points.astype(np.float64)
    x -= x[start]  # a row and not the mean: whole numbers stay whole, so that equal distances compare equal
    lengths = np.einsum("nc,nc->n", x, x)
    bound = np.full(n, np.inf) if anchor is None else np.square(anchor)
    picks = np.empty(min(count, n), np.int64)
    known = np.zeros(n, np.int64)
    size = 0
    row = start if anchor is None else int(np.argmax(bound))
    while size < len(picks):
        picks[size] = row
        size += 1
        if size == 1:
            _update(bound, known, np.arange(n), x, lengths, picks[:size])
        row = _farthest(bound, known, x, lengths, picks[:size])
        if bound[row] <= 0:
            break
    return Coreset(picks[:size].copy(), float(np.sqrt(max(bound[row], 0.0))))


def _farthest(
    bound: NDArray[np.float64],
    known: NDArray[np.int64],
    x: NDArray[np.float64],
    lengths: NDArray[np.float64],
    picks: NDArray[np.int64],
) -> int:
    """The row with the largest distance to the picks, bringing up to date only rows that might be it."""
    while True:
        row = int(np.argmax(bound))
        if known[row] == len(picks) or bound[row] <= 0:
            return row
        batch = min(BATCH, len(bound))
        stale = np.argpartition(bound, len(bound) - batch)[len(bound) - batch :]
        stale = stale[known[stale] < len(picks)]
        stale = np.union1d(stale, row)
        _update(bound, known, stale, x, lengths, picks)


def _update(
    bound: NDArray[np.float64],
    known: NDArray[np.int64],
    rows: NDArray[np.int64],
    x: NDArray[np.float64],
    lengths: NDArray[np.float64],
    picks: NDArray[np.int64],
) -> None:
    """Lower the bounds of `rows` by the picks that the least informed of them has not seen."""
    unseen = picks[int(known[rows].min()) :]
    both = lengths[rows, None] + lengths[None, unseen]
    squared = both - 2 * (x[rows] @ x[unseen].T)
    squared[squared <= ROUNDING * both] = 0.0
    bound[rows] = np.minimum(bound[rows], squared.min(axis=1))
    known[rows] = len(picks)


def greedy_from_distances(squared: NDArray[np.floating], count: int, start: int) -> NDArray[np.int64]:
    """The same choice for many small sets at once, from pairwise squared distances (g, n, n): int64 rows (g, count).

    No row is picked twice; where all that is left equals a pick, the lowest of it follows.
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
