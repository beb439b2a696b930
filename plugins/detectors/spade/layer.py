"""One layer that SPADE compares: its cells, windows and blur on a grid, its part of the bank, and the float64 oracle.

A layer's arrays have its tap before their names in a bank: `layer1_mean`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, F64, Mask
from edge.core.detector import Grid, Nominal
from plugins.detectors.common.descriptor import resampling_matrix
from plugins.detectors.common.distances import nearest
from plugins.detectors.common.parameters import Rng
from plugins.detectors.common.pca import Rotation, fit_rotation
from plugins.detectors.common.smoothing import UPSAMPLING, Smoothing
from plugins.detectors.common.tile_layout import layout, split, tile_grid
from plugins.detectors.common.untouched_places import gel_distances, gel_mean, touched_places
from plugins.detectors.spade.parameters import SpadeParameters
from plugins.detectors.spade.window import Blocks, Tables, window_nearest

__all__ = ["Arrays", "Layer"]

Arrays = Mapping[str, NDArray[Any]]

# The most cells from which a layer's leading directions are learnt.
SAMPLES = 4096
EVERY = slice(None)
# Cells, in complete presses, on which the distance between nominal presses is measured at each layer: 12 presses of
# layer1 at 224x224, but two at least.
SCALE_CELLS = 12 * 56 * 56


@dataclass(frozen=True)
class Layer:
    """One tap on a grid."""

    p: SpadeParameters
    grid: Grid
    tap: str

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns on which the layer is compared, of one tile where there are tiles."""
        tile = tile_grid(self.grid)
        h, w = tile.taps[self.tap][1:]
        if not self.p.cell_mm:
            return h, w
        own_mm = min(tile.frame[0] / h, tile.frame[1] / w) / self.grid.pixels_per_mm
        # Slightly below a power of two is rounding.
        side = 2 ** max(0, math.floor(math.log2(self.p.cell_mm / own_mm) + 0.01))
        return -(-h // side), -(-w // side)

    @property
    def tiles(self) -> int:
        return math.prod(layout(self.grid))

    @property
    def count(self) -> int:
        """Cells on which the layer is compared, of all tiles."""
        return self.tiles * math.prod(self.cells)

    @property
    def averaging(self) -> tuple[F64, F64] | None:
        """The matrices that average the tap onto the compared cells, None where it stays as it is."""
        own, cells = tile_grid(self.grid).taps[self.tap][1:], self.cells
        if own == cells:
            return None
        rows, columns = (
            resampling_matrix(n, to, self.p.is_sampled) for n, to in zip(own, cells, strict=True)
        )
        return rows, columns

    @property
    def window(self) -> int | None:
        """The cells that a match may be away; None for anywhere on the map."""
        if self.p.window_mm is None:
            return None
        own = self.cells
        cell_px = min(size / cells for size, cells in zip(tile_grid(self.grid).frame, own, strict=True))
        # Slightly more than an integer number of cells must not become one cell more.
        cells = math.ceil(self.p.window_mm * self.grid.pixels_per_mm / cell_px - 1e-6)
        return cells if cells < max(own) else None

    @property
    def blocks(self) -> Blocks:
        """The blocks in which the layer is searched. Errors: ValueError where it has no window."""
        if self.window is None:
            raise ValueError(f"'{self.tap}' is searched without a window; blocks need a window")
        return Blocks(self.cells, self.window, self.tiles)

    @property
    def smoothing(self) -> Smoothing:
        (h, w), (down, across), p = self.cells, layout(self.grid), self.p
        return Smoothing.of(
            self.grid, (down * h, across * w), p.sigma, UPSAMPLING[p.is_sampled], p.sigma_unit
        )

    def of(self, arrays: Arrays) -> dict[str, NDArray[Any]]:
        """Give the layer's arrays of a bank by their names without the tap."""
        start = f"{self.tap}_"
        return {name.removeprefix(start): array for name, array in arrays.items() if name.startswith(start)}

    def average(self, maps: NDArray[np.floating]) -> NDArray[np.floating]:
        """Average the tap to the compared cells, tiles one under the other: (n, c, tiles * h, w)."""
        tiles = split(maps, self.grid)
        if self.averaging is not None:
            down, across = (matrix.astype(maps.dtype) for matrix in self.averaging)
            tiles = down @ tiles @ across.T
        n, (_, c, h, w) = len(maps), tiles.shape
        return tiles.reshape(n, -1, c, h, w).swapaxes(1, 2).reshape(n, c, -1, w)

    def find_stored(self, nominal: Nominal) -> Mask:
        """Find the cells that keep rows, flat, tile by tile."""
        if not self.p.is_touched_only or self.window is None:
            return np.ones(self.count, np.bool_)
        return touched_places(nominal, self.grid, self.cells, self.p.margin_mm)

    def tables(self, stored: Mask) -> dict[str, NDArray[np.int64]]:
        """Make the tables for the search where some cells are untouched. See `Spade.fit`."""
        tables = Tables.of(self.blocks, np.flatnonzero(stored))
        order = np.empty(len(stored), np.int64)
        order[stored] = tables.back
        order[~stored] = tables.queries.size + np.arange((~stored).sum())
        return {"queries": tables.queries, "reached": tables.reached, "order": order}

    def fit(
        self, maps: NDArray[np.floating], stored: Mask, dims: int | None, rng: Rng
    ) -> dict[str, NDArray[Any]]:
        """Learn the layer's arrays from its averaged nominal features (n, c, h, w). stored: cells that keep rows."""
        arrays: dict[str, NDArray[Any]] = {}
        if self.p.is_normalised:
            # All-zero features have no length; with any positive number they stay zero.
            floor_length = max(self.p.length_floor(maps), np.finfo(np.float32).tiny)
            arrays["floor"] = np.array([floor_length], np.float32)
        cells, floor = np.flatnonzero(stored), arrays.get("floor")
        drawn = np.arange(len(maps) * len(cells))
        if len(drawn) > SAMPLES:
            drawn = np.sort(rng.choice(drawn, SAMPLES, replace=False))
        parts = np.split(drawn, np.searchsorted(drawn, np.arange(1, len(maps)) * len(cells)))
        sample = [
            _unit(press, floor, cells[part % len(cells)]) for press, part in zip(maps, parts, strict=True)
        ]
        rotation = fit_rotation(np.concatenate(sample), dims)
        arrays["mean"] = rotation.mean
        if rotation.basis is not None:
            arrays["basis"] = rotation.basis
        arrays["bank"] = np.stack([rotation(_unit(press, floor, cells)).astype(np.float32) for press in maps])
        if not stored.all():
            arrays |= {"cells": cells, "gel_cells": np.flatnonzero(~stored), **self.tables(stored)}
        return arrays

    def learn_gel(self, own: Arrays, pressed: NDArray[np.floating], nominal: Nominal) -> tuple[F32, float]:
        """Find the mean of the free gel, and how far nominal frames are from it. pressed: of the kept presses."""
        gel, free = own["gel_cells"], None
        if nominal.no_contact is not None:
            free = np.stack([rows[gel] for rows in _rows(self.average(nominal.no_contact[self.tap]), own)])
        return gel_mean(np.stack([rows[gel] for rows in _rows(pressed, own)]), free)

    def nominal_distance(self, own: Arrays, described: F32) -> float:
        """Find the median distance of a nominal press to the others; nan where there is one press."""
        bank, stored = own["bank"], own.get("cells", np.arange(self.count))
        presses = min(max(2, SCALE_CELLS // self.count), len(described))
        chosen = np.unique(np.linspace(0, len(described) - 1, presses).astype(np.int64))
        medians = []
        for press in chosen:
            others = np.delete(np.arange(len(described)), press)
            if not len(others):
                return math.nan
            near = nearest(described[[press]], described[others], self.p.pixel_neighbours).indices[0]
            rows = np.zeros((self.count, bank.shape[2]))
            rows[stored] = bank[press]
            medians.append(np.median(self._search(rows, others[near], own).reshape(-1)[stored]))
        return float(np.median(medians))

    def distances(self, maps: NDArray[np.floating], galleries: NDArray[np.int64], own: Arrays) -> F64:
        """The oracle: distances (n * tiles, h, w) of presses (n, c, h, w) to their galleries (n, k) of the bank.

        Untouched cells are compared with the free gel.
        """
        each = []
        rows_of = _rows(self.average(maps.astype(np.float64)), own)
        for rows, gallery in zip(rows_of, galleries, strict=True):
            distances = self._search(rows, gallery, own)
            if "gel" in own:
                gel = own["gel_cells"]
                distances.reshape(-1)[gel] = gel_distances(rows[None, gel], own["gel"], own["gel_weight"])[0]
            each.append(distances)
        return np.concatenate(each)

    def _search(self, rows: NDArray[np.floating], presses: NDArray[np.int64], own: Arrays) -> F64:
        """Distances (tiles, h, w) from one press's descriptors (cells, width) to the gallery of the named presses.

        They have no meaning at cells without rows.
        """
        tiles = rows.reshape(-1, *self.cells, rows.shape[1])
        gallery = own["bank"][presses]
        if "cells" in own:
            every = np.full((len(presses), len(rows), rows.shape[1]), np.inf, np.float32)
            every[:, own["cells"]] = gallery
            gallery = every
        gallery = gallery.reshape(len(presses), *tiles.shape)
        if self.window is not None:
            return np.stack(
                [window_nearest(tile, gallery[:, t], self.window) for t, tile in enumerate(tiles)]
            )
        flat = tiles.reshape(len(tiles), -1, rows.shape[1])
        distances = [
            nearest(tile, self.p.gallery_rows(gallery[:, t])).distances for t, tile in enumerate(flat)
        ]
        return np.stack(distances).reshape(tiles.shape[:3])


def _unit(press: NDArray[np.floating], floor: F32 | None, cells: NDArray[np.int64] | slice = EVERY) -> F64:
    """Describe the cells (cells, c) of one press (c, h, w), by unit length when there is a floor."""
    rows = press.reshape(len(press), -1)[:, cells].T.astype(np.float64, order="C")
    return rows if floor is None else rows / (np.sqrt(np.einsum("pc,pc->p", rows, rows))[:, None] + floor)


def _rows(maps: NDArray[np.floating], own: Arrays) -> list[NDArray[np.floating]]:
    """Describe each press as the bank holds it, (cells, width)."""
    rotation = Rotation(own["mean"], own.get("basis"))
    return [rotation(_unit(press, own.get("floor"))) for press in maps]
