"""Euclidean distances to the nearest rows of a bank, right also when the rows are far from zero or nearly equal.

|a-b|^2 = |a|^2 + |b|^2 - 2ab is fast and, far from the origin, wrong. With features around 100 and a true distance of
0.01 the float32 product form is off by a factor of thirty. So the bank's mean is subtracted from both sides everywhere,
and the product form only makes a shortlist. The shortlist's distances are computed again as a sum of squared
differences, and squared distances are never negative. Distances are plain (not squared). Among equals the lowest row of
the bank wins.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64

__all__ = ["Nearest", "nearest"]

# Rows of queries compared at once: bounds the memory at `CHUNK * rows of the bank` numbers.
CHUNK = 1024
# Candidates above k whose distances are also computed exactly.
SPARE = 4


class Nearest(NamedTuple):
    """The nearest rows."""

    distances: F64
    """Plain Euclidean, rising, (q, k)."""
    indices: NDArray[np.int64]
    """Rows of the bank, int64 (q, k)."""


def nearest(
    queries: NDArray[np.floating], bank: NDArray[np.floating], k: int = 1, chunk: int = CHUNK
) -> Nearest:
    """The k nearest rows of `bank` (m, c) to each of `queries` (q, c), in float64: the oracle.

    k is clamped to m. The result does not depend on `chunk`. Errors: ValueError for an empty bank or unequal widths.
    """
    if bank.ndim != 2 or queries.ndim != 2 or bank.shape[1] != queries.shape[1] or not len(bank):
        raise ValueError(f"queries (q, c) need a bank (m >= 1, c), found {queries.shape} and {bank.shape}")
    k = min(k, len(bank))
    candidates = min(k + SPARE, len(bank))
    centre = bank.mean(axis=0, dtype=np.float64)
    rows = bank.astype(np.float64) - centre
    half_norms = 0.5 * np.einsum("mc,mc->m", rows, rows)
    distances = np.empty((len(queries), k))
    indices = np.empty((len(queries), k), np.int64)
    for start in range(0, len(queries), chunk):
        block = queries[start : start + chunk].astype(np.float64) - centre
        gap = half_norms - block @ rows.T
        short = np.sort(np.argpartition(gap, candidates - 1, axis=1)[:, :candidates], axis=1)
        exact = np.sqrt(np.square(block[:, None, :] - rows[short]).sum(axis=2))
        order = np.argsort(exact, axis=1, kind="stable")[:, :k]
        distances[start : start + chunk] = np.take_along_axis(exact, order, axis=1)
        indices[start : start + chunk] = np.take_along_axis(short, order, axis=1)
    return Nearest(distances, indices)
