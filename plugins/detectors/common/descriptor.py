"""Patch descriptors: the features of a place in several taps, resampled to one grid, with or without the cells around.

Three kinds. `cells` is each cell's own channels, all channels of all taps: nothing is blurred, and nothing is computed.
`binned` is that of PatchCore and InReaCh: the window is unfolded channel by channel, resampled to the grid, and
averaged to a fixed number of bins per tap. The taps are then concatenated and averaged again to that number. All of it
is linear and acts on channels alone. So it is one sparse 3x3 convolution per tap at the tap's own size and then an
interpolation: 12.8 MB where the plain order needs 1.13 GB (Wide-ResNet-50-2, 13 taps, 56x56). `means` is the mean of
each channel over the window, all channels of all taps. A tap finer than the grid, which the publications do not have,
is averaged onto it before its windows are taken.

Written twice, for NumPy and as a graph, from the same weights.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64
from edge.core.detector import Features, Grid
from plugins.detectors.common.smoothing import UPSAMPLING, upsampling_matrix
from plugins.detectors.common.tile_layout import emit_split, split, tile_grid
from plugins.onnx_builder import Graph, Value

__all__ = ["BINS", "Descriptor", "Kind", "binned_weights", "resampling_matrix"]

Kind = Literal["binned", "means", "cells"]

# PatchCore's and InReaCh's number of bins, per tap and in the end.
BINS = 1024
# Rows of one convolution: few, so that it needs few channels (the weights are a narrow band).
BAND = 16


class Band(NamedTuple):
    """Neighbouring rows of one tap's part of a binned descriptor."""

    channels: slice
    """The channels that they need."""
    weights: F64
    """Weights of the convolution, (rows, channels, 3, 3)."""


@cache
def binned_weights(channels: int, taps: int, number: int) -> F64:
    """The part of the binned descriptor that tap `number` of `taps` gives: (rows, channels * 9).

    Its rows are those from floor(number * BINS / taps) on; the first and last may be shared with the neighbour.
    Columns are the unfolded window, channel by channel, each row by row.
    """
    size = channels * 9
    first, last = number * BINS // taps, -(-(number + 1) * BINS // taps)
    weights = np.zeros((last - first, size))
    for b in range(BINS):
        low, high = b * size // BINS, -(-(b + 1) * size // BINS)
        weights[(number * BINS + b) // taps - first, low:high] += 1 / (high - low) / taps
    weights.flags.writeable = False
    return weights


@cache
def _bands(channels: int, taps: int, number: int) -> tuple[Band, ...]:
    """The rows of one tap's part, a few at a time, each with the channels that they need."""
    weights = binned_weights(channels, taps, number).reshape(-1, channels, 3, 3)
    bands = []
    for first in range(0, len(weights), BAND):
        band = weights[first : first + BAND]
        used = np.flatnonzero(band.any(axis=(0, 2, 3)))
        chosen = slice(int(used[0]), int(used[-1]) + 1)
        bands.append(Band(chosen, np.ascontiguousarray(band[:, chosen])))
    return tuple(bands)


@dataclass(frozen=True)
class Descriptor:
    """How taps become descriptors."""

    taps: tuple[str, ...]
    """The taps in this order."""
    grid_tap: str
    """The tap whose grid the descriptors are on."""
    kind: Kind
    """See the module."""
    is_sampled: bool
    """a cell represents its top left pixel, the centre of its convolution, instead of a square of pixels."""

    def __post_init__(self) -> None:
        if not self.taps or len(set(self.taps)) != len(self.taps) or self.grid_tap not in self.taps:
            raise ValueError(f"taps are distinct and hold the grid_tap '{self.grid_tap}', found {self.taps}")
        if self.kind not in ("binned", "means", "cells"):
            raise ValueError(f"a descriptor is binned, means or cells, found '{self.kind}'")

    def cells(self, grid: Grid) -> tuple[int, int]:
        """Rows and columns of the grid, of one tile where there are tiles."""
        return tile_grid(grid).taps[self.grid_tap][1:]

    def width(self, grid: Grid) -> int:
        """Numbers per descriptor."""
        return BINS if self.kind == "binned" else sum(grid.taps[tap][0] for tap in self.taps)

    def numpy(
        self,
        features: Features,
        grid: Grid,
        scales: Mapping[str, float],
        dtype: type[np.floating] = np.float64,
    ) -> NDArray[np.floating]:
        """Descriptors (n * tiles, cells, width) of n presses. scales: tap to its features' factor, 1 if absent."""
        maps = {tap: split(features[tap], grid) for tap in self.taps}
        grid = tile_grid(grid)
        n = len(maps[self.taps[0]])
        columns = np.zeros((n, self.width(grid), *self.cells(grid)), dtype)
        at = 0
        for number, tap in enumerate(self.taps):
            x = maps[tap].astype(dtype) * dtype(scales.get(tap, 1.0))
            down, across = (matrix.astype(dtype) for matrix in self._resampling(grid, tap))
            if x.shape[2:] == self.cells(grid):
                part = self._native(x, number)
            elif self._is_finer(grid, tap):
                part = self._native(down @ x @ across.T, number)
            else:
                part = down @ self._native(x, number) @ across.T
            if self.kind == "binned":
                at = number * BINS // len(self.taps)
            columns[:, at : at + part.shape[1]] += part
            at += part.shape[1]
        return np.swapaxes(columns.reshape(n, len(columns[0]), -1), 1, 2)

    def emit(self, graph: Graph, grid: Grid, scales: Value | None) -> Value:
        """Do the same in a graph: inputs for the taps; descriptors as columns (n * tiles, width, cells).

        scales: (taps,).
        """
        parts: list[Value] = []
        whole, grid = grid, tile_grid(grid)
        for number, tap in enumerate(self.taps):
            x = graph.input(tap, ("n", *whole.taps[tap]))
            x = emit_split(graph, x, whole.taps[tap], whole)
            if scales is not None:
                x = graph.op("Mul", x, graph.op("Gather", scales, graph.ints(number), axis=0))
            if self._is_finer(grid, tap):
                part = self._emit_native(graph, self._emit_resampled(graph, x, grid, tap), grid, number)
            else:
                part = self._emit_resampled(graph, self._emit_native(graph, x, grid, number), grid, tap)
            if parts and self.kind == "binned" and number * BINS % len(self.taps):
                parts[-1], part = _emit_shared_row(graph, parts[-1], part)
            parts.append(part)
        columns = graph.concat(parts, 1)
        h, w = self.cells(grid)
        return graph.reshape(columns, 0, self.width(grid), h * w)

    def _native(self, x: NDArray[np.floating], number: int) -> NDArray[np.floating]:
        """Describe one tap at its own size: (n, c, h, w) to (n, rows, h, w)."""
        if self.kind == "cells":
            return x
        n, c, h, w = x.shape
        padded = np.pad(x, ((0, 0), (0, 0), (1, 1), (1, 1)))
        if self.kind == "means":
            down = padded[:, :, :h] + padded[:, :, 1 : h + 1] + padded[:, :, 2:]
            across = down[..., :w] + down[..., 1 : w + 1] + down[..., 2:]
            mean: NDArray[np.floating] = across / x.dtype.type(9)
            return mean
        windows = np.stack([padded[:, :, i : i + h, j : j + w] for i in range(3) for j in range(3)], axis=2)
        parts = []
        for band in _bands(c, len(self.taps), number):
            rows = band.weights.astype(x.dtype).reshape(len(band.weights), -1)
            parts.append(rows @ windows[:, band.channels].reshape(n, rows.shape[1], h * w))
        return np.concatenate(parts, axis=1).reshape(n, -1, h, w)

    def _emit_native(self, graph: Graph, x: Value, grid: Grid, number: int) -> Value:
        if self.kind == "cells":
            return x
        if self.kind == "means":
            return graph.op("AveragePool", x, kernel_shape=[3, 3], pads=[1, 1, 1, 1], count_include_pad=1)
        parts = []
        for band in _bands(grid.taps[self.taps[number]][0], len(self.taps), number):
            chosen = graph.slice(x, band.channels.start, band.channels.stop, 1)
            weights = graph.constant(band.weights.astype(np.float32))
            parts.append(graph.op("Conv", chosen, weights, pads=[1, 1, 1, 1]))
        return graph.concat(parts, 1)

    def _is_finer(self, grid: Grid, tap: str) -> bool:
        return grid.taps[tap][1] > self.cells(grid)[0]

    def _resampling(self, grid: Grid, tap: str) -> tuple[F64, F64]:
        """The matrices that resample a tap to the grid: (grid rows, tap rows) and (grid columns, tap columns)."""
        rows, columns = (
            resampling_matrix(n, to, self.is_sampled)
            for n, to in zip(grid.taps[tap][1:], self.cells(grid), strict=True)
        )
        return rows, columns

    def _emit_resampled(self, graph: Graph, native: Value, grid: Grid, tap: str) -> Value:
        if grid.taps[tap][1:] == self.cells(grid):
            return native
        rows, columns = self._resampling(grid, tap)
        return graph.between(rows, native, columns)


def resampling_matrix(cells: int, onto: int, is_sampled: bool) -> F64:
    """Resample one axis: bilinear onto a finer grid, by the transposed weights onto a coarser one (none is skipped)."""
    if cells <= onto:
        return upsampling_matrix(cells, onto, UPSAMPLING[is_sampled])
    turned = upsampling_matrix(onto, cells, UPSAMPLING[is_sampled]).T
    weights: F64 = turned / turned.sum(axis=1, keepdims=True)
    return weights


def _emit_shared_row(graph: Graph, upper: Value, lower: Value) -> tuple[Value, Value]:
    """Add the first row of `lower` to the last of `upper`, where two taps share one, and drop it from `lower`."""
    end = graph.ints(np.iinfo(np.int64).max)
    first = graph.slice(lower, 0, 1, 1)
    last = graph.op("Slice", upper, graph.ints(-1), end, graph.ints(1))
    rest = graph.slice(upper, 0, -1, 1)
    joined = graph.op("Concat", rest, graph.op("Add", last, first), axis=1)
    return joined, graph.op("Slice", lower, graph.ints(1), end, graph.ints(1))
