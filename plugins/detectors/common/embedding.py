"""Several taps become one descriptor per cell of one grid: chosen or projected channels, aligned and balanced.

The same steps are here twice: in NumPy (for the fit and the float64 oracle) and as a graph. Channels
are chosen or projected at each tap's own resolution, before the coarse taps are repeated onto the grid: equal in value
(both are linear) and up to sixteen times cheaper.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64, Mask
from edge.core.detector import Features, Grid, Nominal
from edge.core.errors import FitError
from plugins.detectors.common.parameters import EmbeddingParameters, Rng
from plugins.detectors.common.tile_layout import layout
from plugins.onnx_builder import Graph, Value

__all__ = ["Embedding", "blocks", "learn_embedding", "require_touched", "split_channels", "touched_cells"]

# A tap's nominal deviation is taken to be at least this part of its root mean square: identical or single presses
# have no deviation. Our value: pressing one real part again changes features by several per cent.
DEVIATION_FLOOR = 1e-2
# Cells embedded at once during a fit: bounds the memory at BLOCK * presses * channels float64 numbers.
BLOCK = 128


@dataclass(frozen=True)
class Embedding:
    """A choice on a grid, with the channels drawn and the scales measured at fit.

    arrays, per tap: `channels_TAP` int64 (k,) of a random choice; `projection_TAP` float32 (c, d) of a semi-orthogonal
    one, its scale included; `scales` float32 (taps,) otherwise, where balanced.
    """

    choice: EmbeddingParameters
    grid: Grid
    arrays: Mapping[str, NDArray[Any]]

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.grid.taps[self.choice.grid_tap][1:]

    @property
    def count(self) -> int:
        """Cells of the grid."""
        return self.cells[0] * self.cells[1]

    @property
    def width(self) -> int:
        """Channels of a descriptor."""
        first = self.choice.taps[0]
        if f"projection_{first}" in self.arrays:
            return int(self.arrays[f"projection_{first}"].shape[1])
        return sum(len(self._channels_of(tap)) for tap in self.choice.taps)

    def numpy(self, features: Features, dtype: type[np.floating] = np.float64) -> "Embedded":
        """The descriptors of n presses, made cell by cell on demand."""
        return Embedded(self, {tap: self._native(tap, features[tap], dtype) for tap in self.choice.taps})

    def emit(self, graph: Graph) -> Value:
        """Do the same in a graph: inputs for the taps and arrays, result float32 (n, cells, d).

        A tap of which no channel was drawn is no input.
        """
        read = [(index, tap) for index, tap in enumerate(self.choice.taps) if len(self._channels_of(tap))]
        if "scales" in self.arrays:
            graph.input("scales", (len(self.choice.taps),))
        parts = [self._emit_tap(graph, index, tap) for index, tap in read]
        if self.choice.projection == "semi_orthogonal":
            return reduce(lambda total, part: graph.op("Add", total, part), parts)
        return graph.concat(parts, 2)

    def index(self, tap: str) -> NDArray[np.int64]:
        """The flat cell of `tap` (averaged to the grid where it is finer) for each cell of the grid, int64 (cells,)."""
        shape = self._shape(tap)
        rows, columns = (
            _repeat(of, to, self.choice.is_sampled, count)
            for of, to, count in zip(shape, self.cells, layout(self.grid), strict=True)
        )
        flat: NDArray[np.int64] = (rows[:, None] * shape[1] + columns[None]).ravel()
        return flat

    def _channels_of(self, tap: str) -> NDArray[np.int64]:
        everything = np.arange(self.grid.taps[tap][0])
        chosen: NDArray[np.int64] = self.arrays.get(f"channels_{tap}", everything)
        return chosen

    def _pool(self, tap: str) -> int:
        """The factor by which a finer tap is averaged down; 1 for the others."""
        return max(1, round(self.grid.taps[tap][1] / self.cells[0]))

    def _shape(self, tap: str) -> tuple[int, int]:
        """Rows and columns of a tap after averaging."""
        _, h, w = self.grid.taps[tap]
        k = self._pool(tap)
        return -(-h // k), -(-w // k)

    def _native(self, tap: str, x: NDArray[np.floating], dtype: type[np.floating]) -> NDArray[np.floating]:
        """(n, c, h, w) to descriptors' parts at the tap's own resolution: (n, cells of the tap, part)."""
        x = _average(x, self._pool(tap))
        x = x.reshape(*x.shape[:2], -1)
        if f"projection_{tap}" in self.arrays:
            projection = self.arrays[f"projection_{tap}"].astype(dtype)
            # Cell by cell, as `at` reads them: one cell of all presses is one piece of memory.
            native = np.empty((x.shape[2], len(x), projection.shape[1]), dtype)
            # Press by press: a copy of all in the other order would take as much memory as the features.
            for number, press in enumerate(x):
                native[:, number] = press.T.astype(dtype, copy=False) @ projection
            return native.swapaxes(0, 1)
        scale = self.arrays["scales"][self.choice.taps.index(tap)] if "scales" in self.arrays else 1.0
        chosen: NDArray[np.floating] = np.swapaxes(x[:, self._channels_of(tap)], 1, 2).astype(dtype) * dtype(
            scale
        )
        return chosen

    def _emit_tap(self, graph: Graph, position: int, tap: str) -> Value:
        channels, h, w = self.grid.taps[tap]
        x = graph.input(tap, ("n", channels, h, w))
        k = self._pool(tap)
        if k > 1:
            x = graph.op(
                "AveragePool", x, kernel_shape=[k, k], strides=[k, k], ceil_mode=1, count_include_pad=0
            )
        if f"channels_{tap}" in self.arrays:
            x = graph.op(
                "Gather",
                x,
                graph.input(f"channels_{tap}", self.arrays[f"channels_{tap}"].shape, "int64"),
                axis=1,
            )
        rows, columns = self._shape(tap)
        x = graph.reshape(graph.transpose(x, 0, 2, 3, 1), 0, rows * columns, len(self._channels_of(tap)))
        if f"projection_{tap}" in self.arrays:
            x = graph.op("MatMul", x, graph.input(f"projection_{tap}", (channels, self.width)))
        elif "scales" in self.arrays:
            x = graph.op("Mul", x, graph.op("Gather", "scales", graph.ints(position), axis=0))
        if (rows, columns) != self.cells:
            x = graph.op("Gather", x, graph.constant(self.index(tap)), axis=1)
        return x


@dataclass(frozen=True)
class Embedded:
    """Descriptors of n presses."""

    embedding: Embedding
    native: Mapping[str, NDArray[np.floating]]
    """Tap to (n, cells of the tap, part)."""

    def at(self, cells: NDArray[np.int64]) -> F64:
        """Descriptors at flat cells of the grid: float64 (len(cells), n, d)."""
        taps = self.embedding.choice.taps
        parts = [self.native[tap].swapaxes(0, 1)[self.embedding.index(tap)[cells]] for tap in taps]
        if self.embedding.choice.projection == "semi_orthogonal":
            total = parts[0].astype(np.float64, order="C")
            for part in parts[1:]:
                total += part
            return total
        return np.concatenate(parts, axis=2, dtype=np.float64)


def blocks(count: int) -> Iterator[slice]:
    """`count` cells in parts of bounded memory."""
    for start in range(0, count, BLOCK):
        yield slice(start, min(start + BLOCK, count))


def learn_embedding(
    choice: EmbeddingParameters, grid: Grid, nominal: Nominal, touched: Mask, rng: Rng
) -> Embedding:
    """Draw the channels and measure the scales. touched: flat bool over the grid's cells, where scales are measured.

    Errors: FitError when no channel is left, or one of the list does not exist.
    """
    counts = [grid.taps[tap][0] for tap in choice.taps]
    total = sum(counts)
    if not total:
        raise FitError(f"the taps {', '.join(choice.taps)} have no channels; use a trunk that gives some")
    bare = Embedding(choice, grid, {})
    deviations = [
        _deviation(_average(nominal.features[tap], bare._pool(tap)), np.unique(bare.index(tap)[touched]))
        for tap in (choice.taps if choice.is_balanced else ())
    ]
    scales = 1 / np.array(deviations or [1.0] * len(counts))
    channels = min(choice.channels or total, total)
    arrays: dict[str, NDArray[Any]] = {}
    ends = np.cumsum(counts)
    if choice.projection == "semi_orthogonal":
        frame = np.linalg.qr(rng.normal(size=(total, channels)))[0]
        for tap, scale, end, count in zip(choice.taps, scales, ends, counts, strict=True):
            arrays[f"projection_{tap}"] = (frame[end - count : end] * scale).astype(np.float32)
        return Embedding(choice, grid, arrays)
    if choice.projection == "random":
        listed = choice.listed_channels
        drawn = _check_channels(listed, total) if listed else rng.choice(total, channels, False)
        arrays |= split_channels(np.sort(drawn), choice.taps, grid)
    if choice.is_balanced:
        arrays["scales"] = scales.astype(np.float32)
    return Embedding(choice, grid, arrays)


def split_channels(
    channels: NDArray[np.int64], taps: Sequence[str], grid: Grid
) -> dict[str, NDArray[np.int64]]:
    """Split rising channels, counted through all taps, into `channels_TAP` of each tap."""
    ends = np.cumsum([0, *(grid.taps[tap][0] for tap in taps)])
    parts = np.split(channels, np.searchsorted(channels, ends[1:-1]))
    return {f"channels_{tap}": part - first for tap, part, first in zip(taps, parts, ends[:-1], strict=True)}


def touched_cells(nominal: Nominal, grid: Grid, cells: tuple[int, int], margin_mm: float) -> Mask:
    """Find the cells that see a touched pixel within the margin around their square: flat bool (rows * columns,).

    All of them where the touch is not known.
    """
    if nominal.touched is None:
        return np.ones(cells[0] * cells[1], bool)
    margin = margin_mm * grid.pixels_per_mm
    count = np.pad(nominal.touched.astype(np.int64), ((1, 0), (1, 0))).cumsum(0).cumsum(1)
    bounds = []
    for first, side, pixels in zip(*_squares(grid, cells), grid.frame, strict=True):
        low = np.clip(np.floor(first - margin), 0, pixels).astype(np.int64)
        bounds.append((low, np.clip(np.ceil(first + side + margin), 0, pixels).astype(np.int64)))
    (top, bottom), (left, right) = bounds
    inside = (
        count[np.ix_(bottom, right)]
        - count[np.ix_(top, right)]
        - count[np.ix_(bottom, left)]
        + count[np.ix_(top, left)]
    )
    touched: Mask = (inside > 0).ravel()
    return touched


def require_touched(touched: Mask) -> Mask:
    """Give the touched cells. Errors: FitError for none."""
    if not touched.any():
        raise FitError("no nominal press touches the inspected region; move the region or press the part")
    return touched


def _check_channels(channels: tuple[int, ...], total: int) -> NDArray[np.int64]:
    """Give the channels as an array. Errors: FitError for one that the taps do not have."""
    if max(channels) >= total:
        raise FitError(
            f"channel_list names channel {max(channels)}, the taps have {total} together, 0 to {total - 1}"
        )
    return np.array(channels, np.int64)


def _squares(grid: Grid, cells: tuple[int, int]) -> tuple[tuple[F64, ...], tuple[float, float]]:
    """First pixel of every row and column of a grid, and the sides of a cell in pixels."""
    if grid.tiles is None:
        sides = (grid.frame[0] / cells[0], grid.frame[1] / cells[1])
        firsts = tuple(
            np.arange(number, dtype=np.float64) * side for number, side in zip(cells, sides, strict=True)
        )
        return firsts, sides
    of_tile = cells[0] // len(grid.tiles.rows), cells[1] // len(grid.tiles.columns)
    return grid.tiles.edges(of_tile), (grid.tiles.size / of_tile[0], grid.tiles.size / of_tile[1])


def _repeat(cells: int, onto: int, is_sampled: bool, tiles: int = 1) -> NDArray[np.int64]:
    """Which of `cells` represents each of `onto` finer cells: floor, or the nearest sample (ties to the right).

    tiles: how many tiles are along the axis; no cell represents one of another tile.
    """
    if tiles > 1:
        index_in_tile = _repeat(cells // tiles, onto // tiles, is_sampled)
        return (np.arange(tiles)[:, None] * (cells // tiles) + index_in_tile).ravel()
    if cells >= onto:
        return np.arange(onto)
    ratio = 2 ** round(np.log2(onto / cells)) if is_sampled else 0
    index = (np.arange(onto) + ratio // 2) // ratio if is_sampled else np.arange(onto) * cells // onto
    return np.minimum(index, cells - 1).astype(np.int64)


def _average(x: NDArray[np.floating], k: int) -> NDArray[np.floating]:
    """Means over k x k squares, (n, c, h/k, w/k); partial squares at the right and bottom over their own cells."""
    if k == 1:
        return x
    sums = np.add.reduceat(
        np.add.reduceat(x, np.arange(0, x.shape[2], k), axis=2), np.arange(0, x.shape[3], k), axis=3
    )
    ones = np.ones(x.shape[2:], x.dtype)
    counts = np.add.reduceat(
        np.add.reduceat(ones, np.arange(0, x.shape[2], k), axis=0), np.arange(0, x.shape[3], k), axis=1
    )
    averaged: NDArray[np.floating] = sums / counts
    return averaged


def _deviation(x: NDArray[np.floating], cells: NDArray[np.int64]) -> float:
    """Root mean square deviation between presses at one cell and channel, at least the floor; 1 where all is zero."""
    squares = power = 0.0
    flat = x.reshape(*x.shape[:2], -1)
    scale = max(float(flat.max()), -float(flat.min())) or 1.0
    chosen = slice(None) if len(cells) == flat.shape[2] else cells
    for channel in range(flat.shape[1]):
        values = flat[:, channel, chosen].astype(np.float64, order="C")
        values /= scale
        power += float(np.square(values).mean())
        squares += float(values.var(axis=0, ddof=1).mean()) if len(values) > 1 else 0.0
    root = np.sqrt(max(squares, DEVIATION_FLOOR**2 * power) / flat.shape[1])
    return float(root * scale) or 1.0
