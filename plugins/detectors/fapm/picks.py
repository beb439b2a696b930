"""k-centre within groups of nominal rows: which rows are picked, and how far every row is from the picks.

Small groups compare all pairs of their rows, many groups at once. A group of many rows picks in fronts: its rows with
the largest distances to the picks so far. A pick is compared with the front alone, until a row outside might be
farther; all rows are then compared with the picks of the front in one product. Old distances are upper bounds, so the
picks are those of a search that compares each pick with all rows, but where rounding decides between equal rows.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plugins.detectors.common.coreset import greedy_from_distances

__all__ = ["Chosen", "pick", "together"]

# Pairwise distances held at once during a fit (float32 numbers, 16 MB: they stay in the cache).
PAIRS = 4 * 2**20
# Rows of a group from which on it picks in fronts.
MANY_ROWS = 512
# Rows of a front. With 1520 to 6080 rows of 64 numbers a fit takes the same time within a tenth from 96 to 256.
FRONT = 128
# Numbers of rows held at once where groups pick in fronts (32 MB).
HELD = 8 * 2**20
# A squared distance below this part of the two squared lengths is rounding of the float32 product form.
ROUNDING = 2e-6


class Chosen(NamedTuple):
    """picks: int64 (g, count). Squared distances float32 (g, n): nearest, to the nearest pick; apart, to the nearest
    pick of another press, infinite where there is none."""

    picks: NDArray[np.int64]
    nearest: NDArray[np.float32]
    apart: NDArray[np.float32]


def together(rows: int, width: int) -> int:
    """Limit how many groups of this many rows are picked from at once, for the memory."""
    return max(1, PAIRS // rows**2 if rows < MANY_ROWS else HELD // (rows * width))


def pick(x: NDArray[np.float32], count: int, start: int, s: int) -> Chosen:
    """`count` picks of each group's centred rows (g, n, c), of which each press has s; the first is `start`."""
    lengths = np.einsum("gnc,gnc->gn", x, x)
    if x.shape[1] < MANY_ROWS:
        return _by_pairs(x, lengths, count, start, s)
    each = [_by_fronts(*group, count, start, s) for group in zip(x, lengths, strict=True)]
    return Chosen(*(np.stack(values) for values in zip(*each, strict=True)))


def _by_pairs(x: NDArray[np.float32], lengths: NDArray[np.float32], count: int, start: int, s: int) -> Chosen:
    squared = x @ np.ascontiguousarray(x.swapaxes(1, 2))
    squared *= -2
    squared += lengths[:, :, None]
    squared += lengths[:, None, :]
    np.maximum(squared, 0, out=squared)
    picks = greedy_from_distances(squared, count, start)
    squared = squared[np.arange(len(x))[:, None], picks]
    squared[squared <= _rounding(np.take_along_axis(lengths, picks, 1)[:, :, None], lengths[:, None])] = 0
    nearest, press = squared.min(axis=1), np.arange(x.shape[1]) // s
    squared[press[picks][:, :, None] == press] = np.inf
    return Chosen(picks, nearest, squared.min(axis=1))


def _rounding(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    return ROUNDING * (a + b)


def _by_fronts(
    rows: NDArray[np.float32], lengths: NDArray[np.float32], count: int, start: int, s: int
) -> Chosen:
    """The picks (count,) and distances (n,) of one group of rows (n, c)."""
    group, picks = _Group(rows, lengths, s), np.full(count, start)
    done, end = 0, 1
    while True:
        group.compare(picks[done:end])
        done = end
        if done == count:
            break
        front = group.front(min(FRONT, count - done))
        end = done + len(front)
        picks[done:end] = front
    nearest, apart = np.maximum(group.bound, 0), np.maximum(group.apart, 0)
    _clear_rounding(rows, lengths, picks, s, nearest, apart)
    return Chosen(picks, nearest, apart)


class _Group:
    """One group's squared distances (n,). bound: to the nearest pick, -1 for a pick. apart: as in `Chosen`."""

    def __init__(self, rows: NDArray[np.float32], lengths: NDArray[np.float32], s: int) -> None:
        n, c = rows.shape
        # Columns (b, 1, |b|^2): a product with (-2a, |a|^2, 1) is the squared distance. BLAS is faster with columns.
        self._columns = np.ones((c + 2, n), np.float32)
        self._columns[:c], self._columns[-1] = rows.T, lengths
        self._s, self._picked = s, np.zeros(n, np.bool_)
        # To the nearest pick of the same press.
        self._own = np.full((n // s, s), np.inf, np.float32)
        self.bound, self.apart = np.full((2, n), np.inf, np.float32)

    def _asking(self, picks: NDArray[np.int64]) -> NDArray[np.float32]:
        asking = -2 * self._columns[:, picks].T
        asking[:, -2], asking[:, -1] = self._columns[-1, picks], 1
        return asking

    def compare(self, picks: NDArray[np.int64]) -> None:
        """All rows with new picks."""
        squared = self._asking(picks) @ self._columns
        by_press, every, press = (
            squared.reshape(-1, *self._own.shape),
            np.arange(len(picks)),
            picks // self._s,
        )
        np.minimum.at(self._own, press, by_press[every, press])
        by_press[every, press] = np.inf
        np.minimum(self.apart, squared.min(axis=0), out=self.apart)
        np.minimum(self.apart, self._own.ravel(), out=self.bound)
        np.maximum(self.bound, 0, out=self.bound)
        self._picked[picks] = True
        self.bound[self._picked] = -1

    def front(self, most: int) -> NDArray[np.int64]:
        """The next picks, 1 to `most`: those that come before any row outside the front."""
        outside = len(self.bound) - min(FRONT, len(self.bound))
        front = np.sort(np.argpartition(self.bound, outside)[outside:])
        left = self.bound[front]
        level, columns, asking, picks = left.min(), self._columns[:, front], self._asking(front), list[int]()
        while len(picks) < most:
            top = int(left.argmax())
            if left[top] <= level:
                break
            picks.append(top)
            np.minimum(left, asking[top] @ columns, out=left)
            left[top] = -1
        if picks:
            return front[picks]
        # More rows are equally far than the front has: the lowest, or many at no distance.
        top = self.bound.max()
        return np.flatnonzero(self.bound == top)[: most if top <= 0 else 1]


def _clear_rounding(
    rows: NDArray[np.float32],
    lengths: NDArray[np.float32],
    picks: NDArray[np.int64],
    s: int,
    nearest: NDArray[np.float32],
    apart: NDArray[np.float32],
) -> None:
    """Zero the distances (n,) that are rounding, which only rows with very near picks can have."""
    limit = _rounding(lengths, lengths[picks].max())
    near = np.flatnonzero((apart <= limit) | ((nearest > 0) & (nearest <= limit)))
    both = lengths[near, None] + lengths[picks]
    squared = both - 2 * (rows[near] @ rows[picks].T)
    is_zero = squared <= ROUNDING * both
    nearest[near[is_zero.any(axis=1)]] = 0
    is_zero &= near[:, None] // s != picks // s
    apart[near[is_zero.any(axis=1)]] = 0
