"""FAPM's graph: distances to the nearest prototypes of both layers, added and weighted."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank, Grid
from plugins.detectors.common.smoothing import emit_scores
from plugins.detectors.common.tile_layout import emit_join, emit_split, layout, tile_grid
from plugins.detectors.fapm.parameters import FapmParameters
from plugins.detectors.fapm.prototypes import emit_prototype_distances
from plugins.onnx_builder import Graph, Value

__all__ = ["coarse_of_fine", "fapm_head", "fewest", "is_unweighted", "shape_of"]


def fapm_head(name: str, grid: Grid, bank: Bank, p: FapmParameters) -> bytes:
    """The serialised head of a bank; the number of prototypes is free."""
    graph = Graph(name)
    fused = _emit_layer(graph, p.layers[0], grid, bank, p)
    if len(p.layers) == 2:
        coarse = _emit_layer(graph, p.layers[1], grid, bank, p)
        above = graph.op("Gather", coarse, graph.constant(coarse_of_fine(grid, p)), axis=1)
        fused = graph.op("Add", fused, above)
    nearest_of = graph.first(fused, 2)
    smoothing = p.smoothing(grid)
    score = None
    if p.weighting != "none":
        top = graph.op("ArgMax", nearest_of, axis=1, keepdims=1)
        neighbours = graph.op("GatherND", fused, top, batch_dims=1)
        score = graph.first(neighbours, 1)
        if not is_unweighted(bank.arrays, p):
            score = graph.op("Mul", score, p.emit_weight(graph, neighbours))
    cells = tile_grid(grid).taps[p.layers[0]][1:]
    emit_scores(graph, emit_join(graph, graph.reshape(nearest_of, -1, *cells), cells, grid), smoothing, score)
    return graph.serialise()


def is_unweighted(arrays: Mapping[str, NDArray[Any]], p: FapmParameters) -> bool:
    """Tell whether the score has no weight because there is no second neighbour."""
    return min(p.neighbours, fewest(arrays, p)) < p.least_weighted


def fewest(arrays: Mapping[str, NDArray[Any]], p: FapmParameters) -> int:
    """Prototypes in the smallest group."""
    kinds = [f"{tap}_{kind}" for tap in p.layers for kind in ("near", "far")]
    return min(int(arrays[name].shape[1]) for name in kinds if name in arrays)


def shape_of(grid: Grid, tap: str) -> tuple[int, int]:
    """Rows and columns of a tap's sub-patches, tiles one under the other."""
    _, h, w = tile_grid(grid).taps[tap]
    return math.prod(layout(grid)) * h, w


def coarse_of_fine(grid: Grid, p: FapmParameters) -> NDArray[np.int64]:
    """Which coarse sub-patch each fine one gets: int64 (fine h * w,)."""
    (fine_h, fine_w), (coarse_h, coarse_w) = (shape_of(grid, tap) for tap in p.layers)
    row, column = p.cover(*np.indices((fine_h, fine_w)).reshape(2, -1))
    flat: NDArray[np.int64] = np.minimum(row, coarse_h - 1) * coarse_w + np.minimum(column, coarse_w - 1)
    return flat


def _emit_layer(graph: Graph, tap: str, grid: Grid, bank: Bank, p: FapmParameters) -> Value:
    """Compute the distances of one layer in a graph."""
    c, h, w = tile_grid(grid).taps[tap]
    tiles = math.prod(layout(grid))
    maps = emit_split(graph, graph.input(tap, ("n", *grid.taps[tap])), grid.taps[tap], grid)
    if p.pooling > 1:
        maps = graph.op(
            "AveragePool", maps, kernel_shape=[p.pooling] * 2, pads=[p.pooling // 2] * 4, count_include_pad=1
        )
    rows = graph.transpose(graph.reshape(maps, -1, c, h * w), 0, 2, 1)
    rows = graph.reshape(rows, -1, tiles * h * w, c)
    distances = emit_prototype_distances(graph, rows, tap, bank.arrays, p.looked_at)
    if p.is_calibrated:
        weight = graph.unsqueeze(graph.input(f"{tap}_weight", (tiles * h * w,)), 1)
        distances = graph.op("Mul", distances, weight)
    return distances
