"""One bank of patch descriptors for the complete grid: PatchCore and InReaCh score with it and fill it differently.

A descriptor is centred and projected on its leading directions with the length of the rest (or kept complete). It is
compared with its nearest row of the bank, wherever on the part that row came from. Each tile is a separate image, and
all tiles share the bank.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, Mask
from edge.core.detector import Bank, Features, Grid, Nominal
from plugins.detectors.common.batched_nearest import PRODUCT_LIMIT, HalvedBank
from plugins.detectors.common.descriptor import Descriptor
from plugins.detectors.common.distances import nearest
from plugins.detectors.common.parameters import Rng
from plugins.detectors.common.pca import Rotation, emit_rotation, fit_rotation
from plugins.detectors.common.tile_layout import emit_join, join, layout, split
from plugins.detectors.common.untouched_places import touched_places
from plugins.onnx_builder import Graph, Value

__all__ = ["PatchBank", "draw_rows", "of_every_place"]

# The most presses and cells from which the mean and the leading directions are learnt.
SAMPLE_PRESSES = 16
SAMPLE_CELLS = 4096
# A tap's deviation is taken to be at least this part of its root mean square, so that a constant tap does not explode.
DEVIATION_FLOOR = 1e-2
# This margin around the touched places counts as touched: the gel is bent there.
MARGIN_MM = 1.0
# Rows of untouched gel that the bank is chosen from, twice, or one of each place if that is more. The gel looks nearly
# the same everywhere and needs few rows.
FREE_GEL_ROWS = 4096


@dataclass(frozen=True)
class PatchBank:
    """How descriptors become rows."""

    descriptor: Descriptor
    dims: int | None
    """Leading directions kept, plus the length of the rest; None keeps all."""
    is_balanced: bool
    """Each tap is divided by its nominal deviation."""
    position_weight: float = 0.0
    """Two more numbers, the place on the grid (0 to 1, down and across) times this; 0 leaves them out."""

    def learn(self, features: Features, grid: Grid, rng: Rng) -> tuple[dict[str, NDArray[Any]], F32]:
        """`scales` (taps,), `mean` (c,) and `basis` (dims, c), and the rows (n, cells of all tiles, width)."""
        arrays: dict[str, NDArray[Any]] = {}
        taps = self.descriptor.taps
        if self.is_balanced:
            arrays["scales"] = np.array([1 / _deviation(features[tap]) for tap in taps], np.float32)
        n = len(features[taps[0]])
        drawn = np.sort(rng.choice(n, min(n, SAMPLE_PRESSES), replace=False))
        sample = np.concatenate([self._describe(features, grid, int(k), arrays) for k in drawn])
        if len(sample) > SAMPLE_CELLS:
            sample = sample[np.sort(rng.choice(len(sample), SAMPLE_CELLS, replace=False))]
        rotation = fit_rotation(sample, self.dims)
        arrays["mean"] = rotation.mean
        if rotation.basis is not None:
            arrays["basis"] = rotation.basis
        each = (self.rows(_press(features, taps, k), grid, arrays, np.float32)[0] for k in range(n))
        first = next(each)
        rows = np.empty((n, *first.shape), np.float32)
        for row, described in zip(rows, chain([first], each), strict=True):
            row[:] = described
        return arrays, rows

    def touched(self, nominal: Nominal, grid: Grid) -> Mask:
        """Which of the rows' cells any nominal press touches: (cells of all tiles,), all where this is not known.
        Errors: FitError where none is touched."""
        return touched_places(nominal, grid, self.descriptor.cells(grid), MARGIN_MM)

    def free_gel(
        self,
        nominal: Nominal,
        grid: Grid,
        arrays: Mapping[str, NDArray[Any]],
        rows: F32,
        rng: Rng,
    ) -> F32:
        """Rows (m, width) of gel that nothing touches: from the presses' untouched cells and frames without contact.

        Without them the bank would score free gel as a defect. Every place has rows, because each press shows the
        corners of the picture, which look like no other place.
        """
        sources = [of_every_place(rows[:, ~self.touched(nominal, grid)], FREE_GEL_ROWS, rng)]
        if nominal.no_contact is not None:
            free = self.rows(nominal.no_contact, grid, arrays, np.float32)
            sources.append(of_every_place(free, FREE_GEL_ROWS, rng))
        return np.concatenate(sources).astype(np.float32)

    def rows(
        self,
        features: Features,
        grid: Grid,
        arrays: Mapping[str, NDArray[Any]],
        dtype: type[np.floating] = np.float64,
    ) -> NDArray[np.floating]:
        """Rows (n, cells of all tiles, width) of presses."""
        rotation = Rotation(arrays["mean"], arrays.get("basis"))
        rows = rotation(self.descriptor.numpy(features, grid, self._scales(arrays), dtype), dtype)
        rows = rows.reshape(len(features[self.descriptor.taps[0]]), -1, rows.shape[2])
        if self.position_weight:
            places = np.broadcast_to(self._places(grid), (*rows.shape[:-1], 2))
            rows = np.concatenate([rows, places], axis=-1)
        return rows.astype(dtype, copy=False)

    def distances(
        self, features: Features, grid: Grid, arrays: Mapping[str, NDArray[Any]], is_squared: bool
    ) -> F64:
        """The oracle: distances (n, grid rows, grid columns) to the nearest row of `bank` (m, width), in float64."""
        rows = self.rows(features, grid, arrays)
        plain = nearest(rows.reshape(-1, rows.shape[2]), arrays["bank"]).distances
        raw = (plain**2 if is_squared else plain).reshape(-1, *self.descriptor.cells(grid))
        return join(raw, grid)

    def emit(self, graph: Graph, grid: Grid, bank: Bank, is_squared: bool) -> Value:
        """Do the same in a graph; the number of rows in the bank is free."""
        width, dims = self.descriptor.width(grid), bank.arrays.get("basis")
        scales = graph.input("scales", (len(self.descriptor.taps),)) if self.is_balanced else None
        columns = self.descriptor.emit(graph, grid, scales)
        basis = None if dims is None else graph.input("basis", dims.shape)
        rows = emit_rotation(graph, columns, graph.input("mean", (width,)), basis)
        if self.position_weight:
            rows = self._emit_placed(graph, rows, grid)
        memory = bank.arrays["bank"]
        distances = self._emit_search(
            graph, rows, graph.input("bank", ("rows", memory.shape[1])), memory.shape, grid
        )
        return graph.op("Mul", distances, distances) if is_squared else distances

    def _emit_placed(self, graph: Graph, rows: Value, grid: Grid) -> Value:
        """Rows (n * tiles, cells, width) with their places added."""
        tiles, cells = math.prod(layout(grid)), math.prod(self.descriptor.cells(grid))
        place = graph.constant(self._places(grid).reshape(1, tiles, cells, 2).astype(np.float32))
        count = graph.op("Div", graph.op("Shape", rows, start=0, end=1), graph.ints(tiles))
        shape = graph.op("Concat", count, graph.ints(tiles, cells, 2), axis=0)
        places = graph.reshape(graph.op("Expand", place, shape), -1, cells, 2)
        return graph.op("Concat", rows, places, axis=2)

    def _emit_search(
        self, graph: Graph, rows: Value, memory: Value, size: tuple[int, ...], grid: Grid
    ) -> Value:
        """Distances (n, grid rows, grid columns), in slices of cells that limit the memory."""
        h, w = self.descriptor.cells(grid)
        step = PRODUCT_LIMIT // (size[0] * math.prod(layout(grid)))
        raw = HalvedBank(graph, memory).search(rows, (h * w, size[1]), step)
        return emit_join(graph, graph.reshape(raw, -1, h, w), (h, w), grid)

    def _describe(
        self, features: Features, grid: Grid, press: int, arrays: Mapping[str, NDArray[Any]]
    ) -> NDArray[np.floating]:
        """Descriptors (cells, c) of one press, float32."""
        taps = _press(features, self.descriptor.taps, press)
        rows: NDArray[np.floating] = self.descriptor.numpy(taps, grid, self._scales(arrays), np.float32)
        return rows.reshape(-1, rows.shape[2])

    def _scales(self, arrays: Mapping[str, NDArray[Any]]) -> dict[str, float]:
        return (
            dict(zip(self.descriptor.taps, arrays["scales"].tolist(), strict=True))
            if "scales" in arrays
            else {}
        )

    def _places(self, grid: Grid) -> F64:
        """The weighted place of every cell in the frame: (cells of all tiles, 2), in the order of the rows."""
        h, w = self.descriptor.cells(grid)
        if grid.tiles is None:
            down, across = (np.arange(n) / n for n in (h, w))
        else:
            edges = grid.tiles.edges((h, w))
            down, across = (edge / size for edge, size in zip(edges, grid.frame, strict=True))
        places = split(np.stack(np.meshgrid(down, across, indexing="ij"))[None], grid)
        return np.asarray(self.position_weight * places.transpose(0, 2, 3, 1).reshape(-1, 2))


def _press(features: Features, taps: tuple[str, ...], press: int) -> Features:
    return {tap: features[tap][press : press + 1] for tap in taps}


def of_every_place(rows: NDArray[np.floating], most: int, rng: Rng) -> NDArray[np.floating]:
    """Rows of presses (n, places, width) as (m, width): equally many of each place, at most `most` or one each."""
    n, places, width = rows.shape
    count = min(n, max(1, most // max(1, places)))
    presses = rng.permuted(np.tile(np.arange(n), (places, 1)), axis=1)[:, :count]
    drawn: NDArray[np.floating] = rows[presses, np.arange(places)[:, None]].reshape(-1, width)
    return drawn


def draw_rows(rows: NDArray[np.floating], most: int | None, rng: Rng) -> F32:
    """Draw at most `most` of the rows, in their order; None: all."""
    if most is not None and len(rows) > most:
        rows = rows[np.sort(rng.choice(len(rows), most, replace=False))]
    return rows.astype(np.float32)


def _deviation(layer: F32) -> float:
    """The root mean square deviation of a tap's channels over all nominal cells, with its floor; 1 if all is zero."""
    top = max(float(layer.max()), -float(layer.min()))
    if top == 0:
        return 1.0
    power, mean = np.empty((2, layer.shape[1]))
    # Channel by channel: a copy of all would take as much memory as the features.
    for channel in range(layer.shape[1]):
        unit = layer[:, channel].ravel() / np.float32(top)
        power[channel] = np.einsum("p,p->", unit, unit, dtype=np.float64) / unit.size
        mean[channel] = unit.mean(dtype=np.float64)
    variance = power - np.square(mean)
    return top * float(np.sqrt(max(variance.mean(), DEVIATION_FLOOR**2 * power.mean())))
