"""Nearest rows inside many small groups at once: a matrix product makes the shortlist, differences decide.

`distances.py` searches one bank. Here every group of queries has a bank of its own (a block of cells, a press's
gallery, a cell of the grid), all groups in one batched product. The rules are the same: both sides centred, squared
distances never negative, the winners measured again as a sum of squared differences, plain (not squared) distances,
and among equals the lowest row wins (ONNX TopK keeps the lower index).
"""

import math

import numpy as np
from numpy.typing import NDArray

from plugins.graph import Graph, Value

__all__ = [
    "FORBIDDEN",
    "PRODUCT_LIMIT",
    "SHORTLIST",
    "Blocks",
    "emit_closest",
    "emit_group_nearest",
    "emit_ranked",
    "emit_window_nearest",
    "window_nearest",
]

# Added to the squared distance of a row that a query may not use: far above any feature distance, far below the end
# of float32.
FORBIDDEN = 1e30
# Rows measured exactly for each query.
SHORTLIST = 4
# Distances that one product may hold: a search over a large bank asks for so many rows at a time (64 MB of float32).
PRODUCT_LIMIT = 16 * 2**20
# Cells along one side of a block, at most.
MOST_SIDE = 10
# What one number of a gathered row and one product of a query and a row cost, in passes over memory: measured on two
# cores with onnxruntime 1.31. Small blocks gather every cell many times, large ones compare with many cells in vain.
GATHER_COST, PRODUCT_COST = 5, 10


def emit_ranked(graph: Graph, bank: Value) -> Value:
    """Rows (..., m, width) with one more number, -|row|^2/2, so that a product with (query, 1) ranks by distance."""
    squares = graph.op("ReduceSum", graph.op("Mul", bank, bank), graph.ints(-1), keepdims=0)
    penalty = graph.op("Unsqueeze", graph.op("Mul", squares, graph.scalar(-0.5)), graph.ints(-1))
    return graph.op("Concat", bank, penalty, axis=-1)


def emit_group_nearest(
    graph: Graph,
    queries: Value,
    ranked: Value,
    width: int,
    k: int = 1,
    shortlist: int = SHORTLIST,
    bias: Value | None = None,
) -> Value:
    """Plain distances (g, q, min(k, m)), rising, from queries (g, q, width) to rows of their own bank.

    ranked: (g, m, width + 1), from `emit_ranked`. Both float32 and centred alike. bias: broadcastable to (g, q, m), 0
    where a row may be used and `FORBIDDEN` where not; a query with fewer than k usable rows gets 1e15 for those that it
    lacks.
    """
    rows_there = graph.op("Shape", ranked, start=1, end=2)
    one = graph.op("Pad", queries, graph.ints(0, 0, 0, 0, 0, 1), graph.scalar(1.0))
    closeness = graph.op("MatMul", one, graph.transpose(ranked, 0, 2, 1))
    if bias is not None:
        closeness = graph.op("Sub", closeness, bias)
    short, rows = graph.ops("TopK", 2, closeness, graph.op("Min", graph.ints(shortlist), rows_there), axis=2)
    chosen = graph.op("GatherND", ranked, graph.reshape(rows, 0, -1, 1), batch_dims=1)
    chosen = graph.op("Slice", chosen, graph.ints(0), graph.ints(width), graph.ints(2))
    shape = graph.op("Concat", graph.op("Shape", rows), graph.ints(width), axis=0)
    difference = graph.op(
        "Sub", graph.op("Reshape", chosen, shape), graph.op("Unsqueeze", queries, graph.ints(2))
    )
    exact = graph.op("ReduceSum", graph.op("Mul", difference, difference), graph.ints(3), keepdims=0)
    if bias is not None:
        forbidden = graph.op("Less", short, graph.scalar(-FORBIDDEN / 2))
        exact = graph.op("Where", forbidden, graph.scalar(FORBIDDEN), exact)
    if k == 1:
        nearest = graph.op("ReduceMin", exact, graph.ints(2), keepdims=1)
    else:
        nearest, _ = graph.ops(
            "TopK", 2, exact, graph.op("Min", graph.ints(k), rows_there), axis=2, largest=0
        )
    return graph.op("Sqrt", nearest)


def emit_closest(graph: Graph, queries: Value, bank: Value, width: int) -> Value:
    """Plain distances (n, g, q) from queries (n, g, q, width) to the closest row of their group's bank (g, m, width).

    The product chooses one row, which is measured again. That is right where rows that are nearly as close lie apart,
    as prototypes picked by k-centre do: a row mistaken within rounding is then measured within rounding. Several times
    faster than a shortlist.
    """
    squares = graph.op("ReduceSumSquare", bank, graph.ints(2), keepdims=0)
    half = graph.op("Unsqueeze", graph.op("Mul", squares, graph.scalar(0.5)), graph.ints(1))
    closeness = graph.op("Sub", graph.op("MatMul", queries, graph.transpose(bank, 0, 2, 1)), half)
    best = graph.op("ArgMax", closeness, axis=3, keepdims=0)
    groups, rows = (graph.op("Squeeze", graph.op("Shape", bank, start=axis, end=axis + 1)) for axis in (0, 1))
    zero, one = (graph.op("Squeeze", graph.ints(number)) for number in (0, 1))
    first = graph.op("Mul", graph.op("Range", zero, groups, one), rows)
    flat = graph.op("Add", best, graph.op("Unsqueeze", first, graph.ints(1)))
    chosen = graph.op("Gather", graph.reshape(bank, -1, width), flat, axis=0)
    difference = graph.op("Sub", queries, chosen)
    return graph.op("Sqrt", graph.op("ReduceSumSquare", difference, graph.ints(3), keepdims=0))


class Blocks:
    """A grid of cells cut into blocks, each with the cells that its window reaches.

    cells: (h, w). window: how many cells a query may look away from its own, in both directions. Cells beyond the
    edge are clamped onto it: clamping never brings a cell into a window that it was outside of, and a cell met
    twice changes no nearest distance. tiles: so many such grids, one after the other, none reaching into another.
    width: numbers per descriptor, which decides how large blocks should be.
    """

    def __init__(self, cells: tuple[int, int], window: int, tiles: int = 1, width: int = 64) -> None:
        if min(cells) < 1 or window < 0:
            raise ValueError(f"blocks need cells and a window of at least 0, found {cells} and {window}")
        self.cells = cells
        self.window = window
        self.tiles = tiles
        side = min(range(1, MOST_SIDE + 1), key=lambda side: _cost(cells, side, window, width))
        self.side = tuple(min(side, n) for n in cells)
        self.count = tuple(-(-n // side) for n, side in zip(cells, self.side, strict=True))

    def queries(self) -> NDArray[np.int64]:
        """The cells of each block, row-major numbers, (blocks, cells per block); clamped in the last block."""
        return self._table(0)

    def gallery(self) -> NDArray[np.int64]:
        """The cells that a block's window reaches, (blocks, cells reached)."""
        return self._table(self.window)

    def back(self) -> NDArray[np.int64]:
        """Where each cell of the grid, row-major, stands in the flattened `queries`: (tiles * h * w,)."""
        (bh, bw), columns = self.side, self.count[1]
        y, x = np.indices(self.cells).reshape(2, -1)
        place = (y // bh * columns + x // bw) * (bh * bw) + y % bh * bw + x % bw
        size = bh * bw * self.count[0] * columns
        return (np.arange(self.tiles)[:, None] * size + place).reshape(-1).astype(np.int64)

    def bias(self) -> NDArray[np.float32]:
        """0 where a query of a block may use a cell reached and `FORBIDDEN` outside its window, (queries, reached)."""
        near = []
        for side in self.side:
            q, g = np.arange(side)[:, None], np.arange(side + 2 * self.window)[None, :]
            near.append(np.abs(g - self.window - q) <= self.window)
        allowed = near[0][:, None, :, None] & near[1][None, :, None, :]
        count = self.side[0] * self.side[1]
        return np.where(allowed.reshape(count, -1), 0.0, FORBIDDEN).astype(np.float32)

    def _table(self, margin: int) -> NDArray[np.int64]:
        axes = []
        for n, side, count in zip(self.cells, self.side, self.count, strict=True):
            reach = np.arange(count)[:, None] * side + np.arange(-margin, side + margin)[None, :]
            axes.append(np.clip(reach, 0, n - 1))
        rows, columns = axes
        one = rows[:, None, :, None] * self.cells[1] + columns[None, :, None, :]
        first = np.arange(self.tiles) * self.cells[0] * self.cells[1]
        table: NDArray[np.int64] = first[:, None, None, None, None] + one
        return table.reshape(self.tiles * self.count[0] * self.count[1], -1)


def _cost(cells: tuple[int, int], side: int, window: int, width: int) -> int:
    """Passes over memory for blocks of that side."""
    sides = [min(side, n) for n in cells]
    blocks = math.prod(-(-n // s) for n, s in zip(cells, sides, strict=True))
    reached = math.prod(s + 2 * window for s in sides)
    return blocks * reached * (GATHER_COST * width + PRODUCT_COST * math.prod(sides))


def emit_window_nearest(
    graph: Graph, rows: Value, presses: Value, gallery: Value, blocks: Blocks, width: int, most: int
) -> Value:
    """Plain distances (n, cells, 1) from each cell's descriptor to the gallery's within its window, block by block.

    rows: (n, cells, width). presses: (m, cells, width), all that there are. gallery: int64 (n, k), which of them, at
    most `most`. So many blocks at a time that memory stays bounded.
    """
    queries, reached = blocks.queries(), blocks.gallery()
    step = max(1, PRODUCT_LIMIT // (queries.shape[1] * reached.shape[1] * most))
    per_block = graph.op("Mul", graph.op("Shape", gallery, start=1, end=2), graph.ints(reached.shape[1]))
    shape = graph.op("Concat", graph.ints(-1), per_block, graph.ints(width + 1), axis=0)
    bias = graph.op("Tile", graph.constant(blocks.bias()[None]), _repeats(graph, gallery))
    cells = blocks.tiles * blocks.cells[0] * blocks.cells[1]
    flat = graph.reshape(emit_ranked(graph, graph.op("Gather", presses, gallery, axis=0)), -1, width + 1)
    first = _emit_first_rows(graph, gallery, cells)
    parts = []
    for start in range(0, len(queries), step):
        part = slice(start, start + step)
        asked = graph.op("Gather", rows, graph.constant(queries[part].reshape(-1)), axis=1)
        asked = graph.reshape(asked, -1, queries.shape[1], width)
        # Row numbers (n, blocks, k, reached) into all galleries laid end to end.
        numbers = graph.op("Add", first, graph.constant(reached[part][None, :, None, :]))
        found = graph.op("Reshape", graph.op("Gather", flat, numbers, axis=0), shape)
        distances = emit_group_nearest(graph, asked, found, width, bias=bias)
        parts.append(graph.reshape(distances, -1, queries[part].size, 1))
    whole = graph.op("Concat", *parts, axis=1) if len(parts) > 1 else parts[0]
    return graph.op("Gather", whole, graph.constant(blocks.back()), axis=1)


def _emit_first_rows(graph: Graph, gallery: Value, cells: int) -> Value:
    """The first row of each press of each gallery (n, k) laid end to end: int64 (n, 1, k, 1)."""
    zero, one, count = (
        graph.op("Squeeze", size) for size in (graph.ints(0), graph.ints(1), graph.op("Size", gallery))
    )
    shape = graph.op("Shape", graph.op("Unsqueeze", gallery, graph.ints(1, 3)))
    numbers = graph.op("Reshape", graph.op("Range", zero, count, one), shape)
    return graph.op("Mul", numbers, graph.ints(cells))


def _repeats(graph: Graph, gallery: Value) -> Value:
    """Repeat counts that lay one mask (1, queries, reached) beside itself for each press of the gallery (n, k)."""
    return graph.op("Concat", graph.ints(1, 1), graph.op("Shape", gallery, start=1, end=2), axis=0)


def window_nearest(
    queries: NDArray[np.floating], gallery: NDArray[np.floating], window: int
) -> NDArray[np.float64]:
    """The float64 oracle: for each cell of `queries` (h, w, c) the nearest of `gallery` (k, h, w, c) within the window.

    Plain distances, (h, w). One shift at a time, no products.
    """
    h, w = queries.shape[:2]
    q = queries.astype(np.float64)
    best = np.full((h, w), np.inf)
    for dy in range(-min(window, h - 1), min(window, h - 1) + 1):
        rows = np.clip(np.arange(h) + dy, 0, h - 1)
        for dx in range(-min(window, w - 1), min(window, w - 1) + 1):
            columns = np.clip(np.arange(w) + dx, 0, w - 1)
            for press in gallery:
                difference = q - press[rows][:, columns]
                best = np.minimum(best, np.einsum("hwc,hwc->hw", difference, difference))
    return np.asarray(np.sqrt(best))
