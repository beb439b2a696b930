"""Euclidean distances to the nearest rows of a bank, right also when the rows are far from zero or nearly equal.

|a-b|^2 = |a|^2 + |b|^2 - 2ab is fast and, far from the origin, wrong: with features around 100 and a true distance of
0.01 the float32 product form is off by a factor of thirty. So everywhere here: the bank's mean is subtracted from both
sides, the product form only makes a shortlist, the shortlist's distances are computed again as a sum of squared
differences, and squared distances are never negative. Distances are plain (not squared). Among equals the lowest
row of the bank wins.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plugins.onnx_builder import Graph, Value

__all__ = ["Nearest", "emit_nearest", "nearest"]

# Rows of queries compared at once: bounds the memory at `CHUNK * rows of the bank` numbers.
CHUNK = 1024


class Nearest(NamedTuple):
    """The nearest rows. distances: (q, k), plain Euclidean, rising. indices: int64 (q, k), rows of the bank."""

    distances: NDArray[np.float64]
    indices: NDArray[np.int64]


def nearest(
    queries: NDArray[np.floating], bank: NDArray[np.floating], k: int = 1, spare: int = 4, chunk: int = CHUNK
) -> Nearest:
    """The k nearest rows of `bank` (m, c) to each of `queries` (q, c), in float64: the oracle.

    k is clamped to m. spare: further candidates that are measured exactly beside the k. The answer does not depend on
    `chunk`. Errors: ValueError for an empty bank or unequal widths.
    """
    if bank.ndim != 2 or queries.ndim != 2 or bank.shape[1] != queries.shape[1] or not len(bank):
        raise ValueError(f"queries (q, c) need a bank (m >= 1, c), found {queries.shape} and {bank.shape}")
    k = min(k, len(bank))
    candidates = min(k + spare, len(bank))
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


def emit_nearest(
    graph: Graph, queries: Value, bank: Value, k: int = 1, spare: int = 3, half_norms: Value | None = None
) -> tuple[Value, Value]:
    """The same in a graph: plain distances (q, k), rising, and their rows int64 (q, k).

    queries: (q, c) and bank: (m, c), float32, **both already centred** by the bank's mean (subtract it once where the
    descriptor is made; store the bank centred). half_norms: (m,), 0.5 |row|^2 of the centred bank; computed in the
    graph when None. The bank needs at least `k + spare` rows (repeat a row to fill up: a duplicate changes no
    nearest distance).
    """
    if half_norms is None:
        squares = graph.op("ReduceSum", graph.op("Mul", bank, bank), graph.ints(1), keepdims=0)
        half_norms = graph.op("Mul", squares, graph.scalar(0.5))
    product = graph.op("MatMul", queries, graph.transpose(bank, 1, 0))
    closeness = graph.op("Sub", product, half_norms)
    _, short = graph.ops("TopK", 2, closeness, graph.ints(k + spare), axis=1)
    exact = _exact(graph, queries, bank, short)
    distances, order = graph.ops("TopK", 2, exact, graph.ints(k), axis=1, largest=0)
    return distances, graph.op("GatherElements", short, order, axis=1)


def _exact(graph: Graph, queries: Value, bank: Value, rows: Value) -> Value:
    """Distances (q, s) between each query (q, c) and its own rows (q, s), as sums of squared differences."""
    chosen = graph.op("Gather", bank, rows, axis=0)
    difference = graph.op("Sub", chosen, graph.op("Unsqueeze", queries, graph.ints(1)))
    squares = graph.op("ReduceSum", graph.op("Mul", difference, difference), graph.ints(2), keepdims=0)
    return graph.op("Sqrt", squares)
