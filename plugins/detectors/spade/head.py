"""SPADE's graph: the nearest presses, then each layer's search among them, then one map."""

from collections.abc import Mapping, Sequence

import numpy as np

from edge.core.arrays import F64
from edge.core.detector import Bank, Grid
from plugins.detectors.common.batched_nearest import PRODUCT_LIMIT, emit_group_nearest, emit_ranked
from plugins.detectors.common.pca import emit_rotation
from plugins.detectors.common.smoothing import Smoothing, upsampling_matrix
from plugins.detectors.common.tile_layout import emit_join, emit_split
from plugins.detectors.common.untouched_places import emit_gel_distances
from plugins.detectors.spade.layer import Arrays, Layer
from plugins.detectors.spade.parameters import SpadeParameters
from plugins.detectors.spade.window import Tables, emit_window_nearest
from plugins.onnx_builder import Graph, Value

__all__ = ["spade_head"]


def spade_head(name: str, grid: Grid, bank: Bank, p: SpadeParameters) -> bytes:
    """The serialised head of a bank; the number of presses is free."""
    graph = Graph(name)
    names = dict.fromkeys((*p.layers, *p.descriptor_taps(grid)))
    taps = {tap: graph.input(tap, ("n", *grid.taps[tap])) for tap in names}
    squared, order = _emit_press_order(graph, taps, grid, p)
    gallery = graph.slice(order, 0, p.pixel_neighbours, 1)
    layers = [Layer(p, grid, tap) for tap in p.layers]
    maps = [_emit_layer(graph, layer, taps[layer.tap], gallery, bank) for layer in layers]
    score = None
    if p.image_score == "presses":
        best = graph.slice(squared, 0, p.image_neighbours, 1)
        best = best if p.is_squared else graph.op("Sqrt", best)
        score = graph.op("ReduceMean", best, graph.ints(1), keepdims=0)
    _emit_layered_scores(graph, maps, [layer.smoothing for layer in layers], score)
    return graph.serialise()


def _emit_press_order(
    graph: Graph, taps: Mapping[str, Value], grid: Grid, p: SpadeParameters
) -> tuple[Value, Value]:
    """Squared distances (n, k) to the nearest presses, rising, and their numbers."""
    means, width = [], 0
    for tap in p.descriptor_taps(grid):
        down, across = p.regions_of(grid, tap)
        size = grid.taps[tap][0] * len(down) * len(across)
        means.append(graph.reshape(graph.between(down, taps[tap], across), -1, size))
        width += size
    described = graph.op("Sub", graph.concat(means, 1), graph.input("press_mean", (width,)))
    presses = graph.input("press_descriptors", ("presses", width))
    difference = graph.op("Sub", graph.unsqueeze(described, 1), presses)
    squared = graph.op("ReduceSum", graph.op("Mul", difference, difference), graph.ints(2), keepdims=0)
    wanted = graph.ints(max(p.image_neighbours, p.pixel_neighbours))
    count = graph.op("Min", wanted, graph.op("Shape", presses, start=0, end=1))
    nearest_squared, order = graph.ops("TopK", 2, squared, count, axis=1, largest=0)
    return nearest_squared, order


def _emit_layer(graph: Graph, layer: Layer, maps: Value, gallery: Value, bank: Bank) -> Value:
    """Weighted distances (n, rows, columns) of one layer to the gallery's presses (n, k)."""
    tap, grid, (h, w) = layer.tap, layer.grid, layer.cells
    c = grid.taps[tap][0]
    maps = emit_split(graph, maps, grid.taps[tap], grid)
    if layer.averaging is not None:
        maps = graph.between(layer.averaging[0], maps, layer.averaging[1])
    columns = graph.reshape(maps, 0, c, h * w)
    if layer.p.is_normalised:
        length = graph.op("ReduceL2", columns, graph.ints(1), keepdims=1)
        columns = graph.op("Div", columns, graph.op("Add", length, graph.input(f"{tap}_floor", (1,))))
    mean = graph.input(f"{tap}_mean", (c,))
    basis = bank.arrays.get(f"{tap}_basis")
    width = c if basis is None else len(basis) + 1
    rows = emit_rotation(
        graph, columns, mean, None if basis is None else graph.input(f"{tap}_basis", basis.shape)
    )
    rows = graph.reshape(rows, -1, layer.count, width)
    search = _emit_whole_search if layer.window is None else _emit_windows
    distances = search(graph, layer, rows, gallery, layer.of(bank.arrays))
    weight = graph.input(f"{tap}_weight", (1,))
    weighted = graph.op("Mul", graph.reshape(distances, -1, h, w), weight)
    return emit_join(graph, weighted, (h, w), grid)


def _emit_windows(graph: Graph, layer: Layer, rows: Value, gallery: Value, own: Arrays) -> Value:
    """Distances (n, tiles * cells) to the gallery within the windows, and to the free gel where no press touches."""
    tap, cells, width = layer.tap, layer.count, own["bank"].shape[2]
    blocks, size = layer.blocks, (width, layer.p.pixel_neighbours)
    if "gel" not in own:
        tables = Tables.of(blocks, np.arange(cells))
        presses = graph.input(f"{tap}_bank", ("presses", cells, width))
        values = graph.constant(tables.queries), graph.constant(tables.reached)
        distances = emit_window_nearest(graph, rows, presses, gallery, blocks, values, size)
        return graph.op("Gather", distances, graph.constant(tables.back), axis=1)
    presses = graph.input(f"{tap}_bank", ("presses", f"{tap}_stored", width))
    queries, reached = (
        graph.input(f"{tap}_{name}", (f"{tap}_blocks", own[name].shape[1]), "int64")
        for name in ("queries", "reached")
    )
    distances = emit_window_nearest(graph, rows, presses, gallery, blocks, (queries, reached), size)
    count = f"{tap}_untouched"
    here = graph.op("Gather", rows, graph.input(f"{tap}_gel_cells", (count,), "int64"), axis=1)
    mean, weight = graph.input(f"{tap}_gel", (count, width)), graph.input(f"{tap}_gel_weight", (1,))
    both = graph.op("Concat", distances, emit_gel_distances(graph, here, mean, weight), axis=1)
    return graph.op("Gather", both, graph.input(f"{tap}_order", (cells,), "int64"), axis=1)


def _emit_whole_search(graph: Graph, layer: Layer, rows: Value, gallery: Value, own: Arrays) -> Value:
    """Distances (n * tiles, cells, 1) to any gallery cell of the same tile, in slices of rows that limit the memory."""
    (h, w), width = layer.cells, own["bank"].shape[2]
    cells = h * w
    presses = graph.input(f"{layer.tap}_bank", ("presses", layer.count, width))
    count = graph.op("Mul", graph.op("Shape", gallery, start=1, end=2), graph.ints(cells))
    gathered = graph.reshape(graph.op("Gather", presses, gallery, axis=0), 0, 0, layer.tiles, cells, width)
    shape = graph.op("Concat", graph.ints(-1), count, graph.ints(width), axis=0)
    bank = graph.op("Reshape", graph.transpose(gathered, 0, 2, 1, 3, 4), shape)
    rows = graph.reshape(rows, -1, cells, width)
    bank = emit_ranked(graph, layer.p.emit_gallery_rows(graph, bank, (h, w, width)))
    step = max(1, PRODUCT_LIMIT // (layer.p.pixel_neighbours * cells))
    parts = [
        emit_group_nearest(graph, graph.slice(rows, first, first + step, 1), bank, width)
        for first in range(0, cells, step)
    ]
    return graph.concat(parts, 1)


def _emit_layered_scores(
    graph: Graph, maps: Sequence[Value], smoothings: Sequence[Smoothing], score: Value | None
) -> None:
    """Finish a head from distances at several grids (n, rows, columns), each smoothed alone and added in pixels.

    Adding after upsampling is the published order; adding on the finest grid would interpolate twice. `raw_map` is the
    sum on the finest grid.
    """
    finest = smoothings[0].cells
    smooth = _emit_sum(graph, maps, [(s.rows, s.columns) for s in smoothings])
    raw = _emit_sum(graph, maps, [_onto(s, finest) for s in smoothings])
    if score is None:
        score = graph.op("ReduceMax", smooth, graph.ints(1, 2), keepdims=0)
    graph.output("score_map", smooth, ("n", *smoothings[0].frame))
    graph.output("score", score, ("n",))
    graph.output("raw_map", raw, ("n", *finest))


def _onto(s: Smoothing, finest: tuple[int, int]) -> tuple[F64, F64]:
    """Return the matrices that resample one grid to the finest, tile by tile."""
    tiles = (1, 1) if s.tiles is None else (len(s.tiles.rows), len(s.tiles.columns))
    rows, columns = (
        np.kron(np.eye(count), upsampling_matrix(n // count, to // count, s.upsampling)).astype(np.float64)
        for n, to, count in zip(s.cells, finest, tiles, strict=True)
    )
    return rows, columns


def _emit_sum(graph: Graph, maps: Sequence[Value], sides: Sequence[tuple[F64, F64]]) -> Value:
    """Emit the sum of rows @ map @ columns.T over the maps."""
    total = ""
    for value, (rows, columns) in zip(maps, sides, strict=True):
        part = graph.between(rows, value, columns)
        total = graph.op("Add", total, part) if total else part
    return total
