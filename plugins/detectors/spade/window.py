"""The nearest row of a few presses within a window around each cell, block by block.

Neighbouring cells share most of their windows. So one product compares a block of cells with all cells that the windows
of the block reach; cells outside a cell's own window are then forbidden. The rules are those of `batched_nearest`:
centred rows, the distance of the winner computed again, plain distances.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64
from plugins.detectors.common.batched_nearest import PRODUCT_LIMIT, emit_range
from plugins.onnx_builder import Graph, Value

__all__ = ["Blocks", "Tables", "emit_window_nearest", "window_nearest"]

# Subtracted from the closeness of a cell that a query may not use: far above any feature distance, far below the end
# of float32.
FORBIDDEN = 1e30
# Cells along one side of a block, at most.
MOST_SIDE = 10
# The cost of gathering one number of a row, in multiplications with one query: measured on two cores with
# onnxruntime 1.31. Small blocks gather every cell many times, large ones compare with many cells outside the windows.
GATHER_COST = 12
# Numbers gathered at once (8 MB: 4 and 16 took 5 % longer after a trunk), unless that makes more parts.
GATHERED, PARTS = 2**21, 16
# ONNX's number for float32.
_FLOAT = 1


class Blocks:
    """A grid of cells cut into blocks, each with the cells that its window reaches.

    cells: (h, w). window: the distance in cells that a query may search from its own, in both directions. Cells beyond
    the edge are clamped to it. Clamping never moves a cell into a window from outside, and a repeated cell changes no
    nearest distance. tiles: the number of such grids, one after the other, none reaching into another.
    """

    def __init__(self, cells: tuple[int, int], window: int, tiles: int = 1) -> None:
        if min(cells) < 1 or window < 0:
            raise ValueError(f"blocks need cells and a window of at least 0, found {cells} and {window}")
        self.cells = cells
        self.window = window
        self.tiles = tiles
        side = min(range(1, MOST_SIDE + 1), key=lambda side: _cost(cells, side, window))
        self.side = tuple(min(side, n) for n in cells)
        self.count = tuple(-(-n // side) for n, side in zip(cells, self.side, strict=True))

    def queries(self) -> NDArray[np.int64]:
        """The cells of each block, row-major numbers, (blocks, cells per block); clamped in the last block."""
        return self._table(0)

    def gallery(self) -> NDArray[np.int64]:
        """The cells that a block's window reaches, (blocks, cells reached)."""
        return self._table(self.window)

    def bias(self) -> F32:
        """0 where a query of a block may use a cell reached and `FORBIDDEN` outside its window, (queries, reached)."""
        near = []
        for side in self.side:
            q, g = np.arange(side)[:, None], np.arange(side + 2 * self.window)[None, :]
            near.append(np.abs(g - self.window - q) <= self.window)
        allowed = near[0][:, None, :, None] & near[1][None, :, None, :]
        count = self.side[0] * self.side[1]
        return np.where(allowed.reshape(count, -1), 0.0, FORBIDDEN).astype(np.float32)

    def step(self, numbers: int) -> int:
        """Limit the blocks to search at once, for the numbers that a cell has in a gallery."""
        reached = int(self.gallery().shape[1]) * numbers
        count = self.tiles * math.prod(self.count)
        wanted = max(GATHERED // reached, -(-count // PARTS))
        return max(1, min(wanted, count, PRODUCT_LIMIT // reached))

    def _table(self, margin: int) -> NDArray[np.int64]:
        axes = []
        for n, side, count in zip(self.cells, self.side, self.count, strict=True):
            reach = np.arange(count)[:, None] * side + np.arange(-margin, side + margin)[None, :]
            axes.append(np.clip(reach, 0, n - 1))
        rows, columns = axes
        in_tile = rows[:, None, :, None] * self.cells[1] + columns[None, :, None, :]
        first = np.arange(self.tiles) * self.cells[0] * self.cells[1]
        table: NDArray[np.int64] = first[:, None, None, None, None] + in_tile
        return table.reshape(self.tiles * self.count[0] * self.count[1], -1)


def _cost(cells: tuple[int, int], side: int, window: int) -> int:
    """The cost of blocks of a side, in multiplications."""
    sides = [min(side, n) for n in cells]
    blocks = math.prod(-(-n // s) for n, s in zip(cells, sides, strict=True))
    reached = math.prod(s + 2 * window for s in sides)
    return blocks * reached * (GATHER_COST + math.prod(sides))


class Tables(NamedTuple):
    """The blocks of the cells of which rows are stored."""

    queries: NDArray[np.int64]
    """Int64 (blocks, q), flat cells."""
    reached: NDArray[np.int64]
    """Int64 (blocks, r), indices of stored rows, or their number where a cell has none."""
    back: NDArray[np.int64]
    """Int64 (stored,), the index of each stored cell in the flattened queries."""

    @classmethod
    def of(cls, blocks: Blocks, stored: NDArray[np.int64]) -> "Tables":
        """stored: flat cells with rows, rising. Blocks without any are left out."""
        cells = blocks.tiles * math.prod(blocks.cells)
        number = np.full(cells, len(stored))
        number[stored] = np.arange(len(stored))
        queries, reached = blocks.queries(), blocks.gallery()
        is_searched = (number[queries] < len(stored)).any(axis=1)
        queries, reached = queries[is_searched], number[reached[is_searched]]
        # Of a cell that its block repeats at the border the first copy is used.
        asked, first = np.unique(queries, return_index=True)
        return cls(queries, reached, first[np.searchsorted(asked, stored)])


def emit_window_nearest(
    graph: Graph,
    rows: Value,
    presses: Value,
    gallery: Value,
    blocks: Blocks,
    tables: tuple[Value, Value],
    size: tuple[int, int],
) -> Value:
    """Plain distances (n, blocks * q) from the descriptors of each block's cells to the gallery's in their windows.

    rows: (n, cells, width). presses: (m, stored, width), all of the bank. gallery: int64 (n, k), which of them.
    tables: `queries` and `reached` of Tables, as values. size: width, and the most presses in a gallery. The product
    chooses the row, whose distance is computed again. If it picks a wrong row, the distance is off by the root of its
    rounding, 3e-4 of the centred rows' length at most. On simulated and real presses that length is 5 times the
    distance in the median and 55 times at most, so the error stays below 1 %, mostly far below.
    """
    width, most = size
    chosen = graph.op("Gather", presses, gallery, axis=0)
    search = _Search(graph, rows, chosen, blocks, width)
    step = blocks.step(width * most)
    parts = []
    for first in range(0, blocks.tiles * math.prod(blocks.count), step):
        part = [graph.slice(table, first, first + step, 0) for table in tables]
        parts.append(search.closest(part[0], part[1]))
    closest = graph.concat(parts, 1)
    return graph.reshape(search.measure(tables[0], closest), 0, -1)


class _Search:
    """The nodes shared by every part of a search: the gallery's concatenated rows, and their half squared lengths."""

    def __init__(self, graph: Graph, rows: Value, chosen: Value, blocks: Blocks, width: int) -> None:
        """chosen: the gallery's rows (n, k, stored, width)."""
        self.graph, self.rows, self.width = graph, rows, width
        bias = blocks.bias()
        self.q, self.r = bias.shape
        self.bias = graph.constant(np.ascontiguousarray(bias.T))
        self.flat = graph.reshape(chosen, -1, width)
        squares = graph.op("ReduceSumSquare", chosen, graph.ints(3), keepdims=1)
        self.ranked = graph.reshape(graph.op("Concat", chosen, squares, axis=3), -1, width + 1)
        self.presses, self.stored = (graph.op("Shape", chosen, start=axis, end=axis + 1) for axis in (1, 2))
        self.last = graph.op("Sub", self.stored, graph.ints(1))
        # The first row of each press of each gallery, (n, k).
        batch = graph.op("Shape", chosen, start=0, end=2)
        numbers = emit_range(graph, graph.op("Mul", graph.op("Shape", chosen, start=0, end=1), self.presses))
        self.first = graph.op("Mul", graph.op("Reshape", numbers, batch), self.stored)

    def closest(self, queries: Value, reached: Value) -> Value:
        """The index of the closest row in the galleries' concatenated rows, int64 (n, blocks, q), for some blocks."""
        graph = self.graph
        asked = graph.op("Gather", self.rows, queries, axis=1)
        # |query - row|^2 falls as query . row - |row|^2 / 2 rises.
        ranking = graph.op("Pad", asked, graph.ints(0, 0, 0, 0, 0, 0, 0, 1), graph.scalar(-0.5))
        here = graph.op("Min", reached, self.last)
        numbers = graph.op("Add", graph.unsqueeze(self.first, 1, 3), graph.unsqueeze(here, 1))
        # The rows as the left side of the product need no repacking: (n, blocks, k * r, width + 1).
        rows = self._shaped(
            graph.op("Gather", self.ranked, numbers, axis=0),
            graph.op("Mul", self.presses, graph.ints(self.r)),
            graph.ints(self.width + 1),
        )
        product = graph.op("MatMul", rows, graph.transpose(ranking, 0, 1, 3, 2))
        product = self._shaped(product, self.presses, graph.ints(self.r, self.q))
        best = graph.op("ReduceMax", product, graph.ints(2), keepdims=0)
        absent = graph.op("Cast", graph.op("Greater", reached, self.last), to=_FLOAT)
        absent = graph.unsqueeze(graph.op("Mul", absent, graph.scalar(FORBIDDEN)), 2)
        allowed = graph.op("Sub", best, graph.op("Add", self.bias, absent))
        cell = graph.op("ArgMax", graph.transpose(allowed, 0, 1, 3, 2), axis=3, keepdims=0)
        # The press whose row won at that cell.
        index = graph.unsqueeze(cell, 2, 3)
        index = graph.op(
            "Expand", index, graph.op("Concat", graph.ints(1, 1), self.presses, graph.ints(1, 1), axis=0)
        )
        there = graph.squeeze(graph.op("GatherElements", product, index, axis=3), 3)
        press = graph.op("ArgMax", there, axis=2, keepdims=0)
        at = graph.op("Add", graph.op("Mul", press, graph.ints(self.r)), cell)
        ends = graph.op("Mul", self.presses, graph.ints(self.r))
        return graph.op("GatherElements", self._shaped(numbers, ends), at, axis=2)

    def measure(self, queries: Value, closest: Value) -> Value:
        """Measure the distance (n, blocks, q) to the closest rows (n, blocks, q), as a sum of squared differences."""
        graph = self.graph
        difference = graph.op(
            "Sub",
            graph.op("Gather", self.flat, closest, axis=0),
            graph.op("Gather", self.rows, queries, axis=1),
        )
        return graph.length(difference, 3)

    def _shaped(self, value: Value, *sizes: Value) -> Value:
        """The sizes after the presses and the blocks, which may be none."""
        shape = self.graph.op("Concat", self.graph.ints(0, 0), *sizes, axis=0)
        return self.graph.op("Reshape", value, shape)


def window_nearest(queries: NDArray[np.floating], gallery: NDArray[np.floating], window: int) -> F64:
    """The float64 oracle: for each cell of `queries` (h, w, c) the nearest of `gallery` (k, h, w, c) within the window.

    Plain distances, (h, w). One shift at a time, no products. A cell that is infinite in the gallery is never near.
    """
    h, w = queries.shape[:2]
    q = queries.astype(np.float64)
    best = np.full((h, w), np.inf)
    rows, columns = min(window, h - 1), min(window, w - 1)
    around = np.pad(gallery, ((0, 0), (rows, rows), (columns, columns), (0, 0)), mode="edge")
    for dy in range(2 * rows + 1):
        for dx in range(2 * columns + 1):
            for press in around[:, dy : dy + h, dx : dx + w]:
                difference = q - press
                best = np.minimum(best, np.einsum("hwc,hwc->hw", difference, difference))
    return np.asarray(np.sqrt(best))
