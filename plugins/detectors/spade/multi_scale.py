"""Several grids of distances, one score map: each grid is smoothed alone and they are added in pixels.

Adding after upsampling is the published order. Adding on the finest grid would interpolate twice.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plugins.detectors.common.smoothing import Smoothing, upsampling_matrix
from plugins.onnx_builder import Graph, Value

__all__ = ["emit_layered_scores"]


def emit_layered_scores(
    graph: Graph, maps: Sequence[Value], smoothings: Sequence[Smoothing], score: Value | None
) -> None:
    """Outputs from distances at several grids (n, rows, columns), each smoothed alone and added in pixels.

    `raw_map` is their sum on the finest grid.
    """
    finest = smoothings[0].cells
    smooth = _emit_sum(graph, maps, [(s.rows, s.columns) for s in smoothings])
    raw = _emit_sum(graph, maps, [_onto(s, finest) for s in smoothings])
    if score is None:
        score = graph.op("ReduceMax", smooth, graph.ints(1, 2), keepdims=0)
    graph.output("score_map", smooth, ("n", *smoothings[0].frame))
    graph.output("score", score, ("n",))
    graph.output("raw_map", raw, ("n", *finest))


def _onto(s: Smoothing, finest: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The matrices that resample one grid to the finest, tile by tile."""
    tiles = (1, 1) if s.tiles is None else (len(s.tiles.rows), len(s.tiles.columns))
    rows, columns = (
        np.kron(np.eye(count), upsampling_matrix(n // count, to // count, s.upsampling)).astype(np.float64)
        for n, to, count in zip(s.cells, finest, tiles, strict=True)
    )
    return rows, columns


def _emit_sum(
    graph: Graph, maps: Sequence[Value], sides: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]
) -> Value:
    """The sum of rows @ map @ columns.T over the maps."""
    total = ""
    for value, (rows, columns) in zip(maps, sides, strict=True):
        right = graph.constant(np.ascontiguousarray(columns.T, np.float32))
        part = graph.op("MatMul", graph.constant(rows.astype(np.float32)), graph.op("MatMul", value, right))
        total = graph.op("Add", total, part) if total else part
    return total
