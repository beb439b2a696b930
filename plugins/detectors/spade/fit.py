"""SPADE: the press is compared with its most similar nominal presses, place by place and at several scales.

Definition (Cohen and Hoshen, "Sub-image anomaly detection with deep pyramid correspondences", 2020). The K nominal
presses with the nearest global descriptors are the gallery. A cell's score at one layer is its distance to the nearest
gallery cell of that layer. Layers are averaged in pixels and blurred once. Read against byungjae89/SPADE-pytorch
@077c67b and the seed paper's scripts.

`paper` is this definition as the seed paper's scripts run it: every gallery position allowed, descriptors of unit
length. `corrected` uses the finest layer without averaging, searches only near the same place and scores a press by its
map. It keeps leading principal directions and as many presses as the bank's size allows, without untouched cells.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from plugins.detectors.common.coreset import k_centre
from plugins.detectors.common.distances import nearest
from plugins.detectors.common.free_gel import (
    gel_distances,
    gel_mean,
    gel_weight,
    touched_places,
)
from plugins.detectors.common.parameters import choose, list_repairs
from plugins.detectors.common.pca import Rotation, fit_rotation
from plugins.detectors.common.tile_layout import join, layout, split, stacked
from plugins.detectors.common.validation import bank_bytes, require_fittable, require_scorable
from plugins.detectors.spade.head import spade_head
from plugins.detectors.spade.paper import PAPER, REPAIRS
from plugins.detectors.spade.parameters import SpadeParameters
from plugins.detectors.spade.window import Tables, window_nearest

__all__ = ["SpadeParameters", "spade"]

# The most cells from which a layer's leading directions are learnt.
SAMPLES = 4096
EVERY = slice(None)
# Cells, in complete presses, on which the distance between nominal presses is measured at each layer: 12 presses of
# layer1 at 224x224, but two at least.
SCALE_CELLS = 12 * 56 * 56


class Spade:
    """SPADE under the entry points `gelgate.detectors`."""

    name = "spade"
    compares_places = True
    is_baseline = False

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> SpadeParameters:
        """The mode's parameters with overrides. Errors: FitError."""
        return choose(self.name, PAPER if mode == "paper" else SpadeParameters(), PAPER, overrides)

    def taps(self, parameters: SpadeParameters) -> tuple[str, ...]:
        """The layers, and `avgpool` where it is requested by name."""
        return (*parameters.layers, "avgpool") if parameters.descriptor == "avgpool" else parameters.layers

    def fit(
        self,
        nominal: Nominal,
        grid: Grid,
        parameters: SpadeParameters,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Bank:
        """Store the presses. Arrays per layer: `<tap>_bank` (presses, cells, width), `<tap>_mean`, `<tap>_basis`,
        `<tap>_weight`, `<tap>_floor`; for the complete press: `press_descriptors` (presses, d), `press_mean`. Where no
        press touches some cells: int64 `<tap>_cells` and `<tap>_gel_cells`, those with rows and the others,
        `<tap>_gel` (cells, width), `<tap>_gel_weight` (1,), and the search's tables `<tap>_queries`, `<tap>_reached`
        and `<tap>_order` (h * w,). Errors: FitError.
        """
        p = parameters
        require_fittable(
            self.name,
            nominal,
            grid,
            tuple(dict.fromkeys((*p.layers, *p.descriptor_taps(grid)))),
        )
        described = _describe(nominal.features, grid, p)
        start = int(rng.integers(len(described)))
        stored = {tap: self._find_stored(nominal, grid, tap, p) for tap in p.layers}
        kept = _affordable(described, nominal.room, stored, grid, p, start)
        press_mean = described[kept].mean(axis=0).astype(np.float32)
        arrays: dict[str, NDArray[Any]] = {
            "press_descriptors": (described[kept] - press_mean).astype(np.float32),
            "press_mean": press_mean,
        }
        facts = _facts(kept, len(described), start, p)
        packing: dict[str, Packing] = {}
        for number, tap in enumerate(p.layers):
            layer = _average(nominal.features[tap][kept], grid, tap, p)
            dims = p.dims[number] if p.dims else None
            arrays |= _fit_layer(tap, layer, np.flatnonzero(stored[tap]), dims, p, rng)
            packing[f"{tap}_bank"] = p.packing
            gel = np.flatnonzero(~stored[tap])
            if len(gel):
                arrays |= {f"{tap}_cells": np.flatnonzero(stored[tap]), f"{tap}_gel_cells": gel}
                arrays |= {
                    f"{tap}_{name}": table for name, table in _tables(stored[tap], grid, tap, p).items()
                }
                # At least float16: their errors do not average out.
                packing[f"{tap}_gel"] = "none" if p.packing == "none" else "float16"
            usual = _nominal_distance(arrays, tap, grid, p)
            if len(gel):
                scatter = _fit_gel(arrays, nominal, layer, grid, tap, p)
                arrays[f"{tap}_gel_weight"] = np.array([gel_weight(scatter, usual)], np.float32)
            arrays[f"{tap}_weight"] = np.array([1 / len(p.layers)], np.float32)
            if p.is_balanced:
                scale = usual if usual > 0 else 1.0
                arrays[f"{tap}_weight"] /= np.float32(scale)
                facts[f"{tap}_nominal_distance"] = scale
            facts[f"{tap}_gel_cells"] = len(gel)
            progress((number + 1) / len(p.layers))
        return Bank(arrays, packing, facts)

    def _find_stored(self, nominal: Nominal, grid: Grid, tap: str, p: SpadeParameters) -> NDArray[np.bool_]:
        """Which cells of a layer keep rows, flat, tile by tile."""
        cells = p.cells(grid, tap)
        if not p.is_touched_only or p.window(grid, tap) is None:
            return np.ones(math.prod(layout(grid)) * math.prod(cells), np.bool_)
        return touched_places(nominal, grid, cells, p.margin_mm)

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: SpadeParameters
    ) -> ScoreMaps:
        """The float64 oracle. Errors: NotScorable for features that are not finite."""
        p = parameters
        require_scorable(self.name, features, (*p.layers, *p.descriptor_taps(grid)))
        described = _describe(features, grid, p) - bank.arrays["press_mean"]
        count = min(max(p.image_neighbours, p.pixel_neighbours), len(bank.arrays["press_descriptors"]))
        near = nearest(described, bank.arrays["press_descriptors"], count)
        score_map = np.zeros((len(described), *grid.frame))
        for tap in p.layers:
            raw = np.concatenate(
                [
                    _distances(row, near.indices[i, : p.pixel_neighbours], bank.arrays, tap, grid, p)
                    for i, row in enumerate(
                        _rows(_average(features[tap].astype(np.float64), grid, tap, p), tap, bank.arrays)
                    )
                ]
            )
            score_map += p.smoothing(grid, tap)(
                join(raw, grid) * bank.arrays[f"{tap}_weight"].astype(np.float64)
            )
        if p.image_score == "map":
            return ScoreMaps(score_map, score_map.max(axis=(1, 2)))
        distances = near.distances[:, : p.image_neighbours]
        return ScoreMaps(score_map, (distances**2 if p.is_squared else distances).mean(axis=1))

    def head(self, grid: Grid, bank: Bank, parameters: SpadeParameters) -> bytes:
        """The graph; the number of presses in the bank is free."""
        return spade_head(self.name, grid, bank, parameters)


def _facts(kept: NDArray[np.intp], presses: int, start: int, p: SpadeParameters) -> dict[str, Any]:
    """The facts of the complete bank, to which those of its layers are added."""
    left_out = f"{len(kept)} of {presses} presses fit into bank_mb; the others are left out (k-centre)"
    return {
        "presses": kept.tolist(),
        "start": start,
        "repairs": list_repairs(p, PAPER, REPAIRS),
        "warnings": [left_out] if len(kept) < presses else [],
    }


def _describe(features: Features, grid: Grid, p: SpadeParameters) -> NDArray[np.float64]:
    """Global descriptors (n, d), float64."""
    parts = []
    for tap in p.descriptor_taps(grid):
        down, across = p.regions_of(grid, tap)
        # Press by press: all of them in float64 would be twice the features.
        parts.append(np.stack([(down @ x.astype(np.float64) @ across.T).ravel() for x in features[tap]]))
    return np.concatenate(parts, axis=1)


def _average(layer: NDArray[np.float32], grid: Grid, tap: str, p: SpadeParameters) -> NDArray[np.floating]:
    """Average a layer to the cells that are compared, tiles one under the other: (n, c, tiles * h, w)."""
    matrices = p.averaging(grid, tap)
    if matrices is None:
        return stacked(layer, grid)
    down, across = (matrix.astype(layer.dtype) for matrix in matrices)
    tiles = down @ split(layer, grid) @ across.T
    under = tiles.reshape(len(layer), -1, *tiles.shape[1:]).swapaxes(1, 2)
    return under.reshape(len(layer), tiles.shape[1], -1, tiles.shape[3])


def _affordable(
    described: NDArray[np.float64],
    room: float,
    stored: Mapping[str, NDArray[np.bool_]],
    grid: Grid,
    p: SpadeParameters,
    start: int,
) -> NDArray[np.int64]:
    """The presses that fit into the bank's size, times `room`, rising; the most different ones where not all do."""
    if p.bank_mb is None:
        return np.arange(len(described))
    per_number, per_row = {"none": (4, 0), "float16": (2, 0), "int8": (1, 4)}[p.packing]
    press, fixed = 4 * described.shape[1], 4 * described.shape[1]
    for number, tap in enumerate(p.layers):
        channels, rows = grid.taps[tap][0], int(stored[tap].sum())
        width = min(p.dims[number] + 1, channels) if p.dims else channels
        # In addition to the rows: mean, basis, floor, weights.
        fixed += 4 * (channels * width + channels + 3)
        press += rows * (width * per_number + per_row)
        gel = len(stored[tap]) - rows
        # At most four bytes per number for the free gel, and the tables.
        fixed += (
            4 * width * gel + sum(table.nbytes for table in _tables(stored[tap], grid, tap, p).values())
            if gel
            else 0
        )
    count = max(1, round(room * ((bank_bytes(p.bank_mb, grid) - fixed) // press)))
    if count >= len(described):
        return np.arange(len(described))
    return np.sort(k_centre(described, count, start).rows)


def _tables(
    stored: NDArray[np.bool_], grid: Grid, tap: str, p: SpadeParameters
) -> dict[str, NDArray[np.int64]]:
    """The tables for the search of a layer with some untouched cells. See `Spade.fit`."""
    tables = Tables.of(p.blocks(grid, tap), np.flatnonzero(stored))
    order = np.empty(len(stored), np.int64)
    order[stored] = tables.back
    order[~stored] = tables.queries.size + np.arange((~stored).sum())
    return {"queries": tables.queries, "reached": tables.reached, "order": order}


def _fit_layer(
    tap: str,
    layer: NDArray[np.floating],
    cells: NDArray[np.int64],
    dims: int | None,
    p: SpadeParameters,
    rng: np.random.Generator,
) -> dict[str, NDArray[Any]]:
    """The arrays of one layer from its nominal features (n, c, h, w). cells: flat, those that keep rows."""
    arrays: dict[str, NDArray[Any]] = {}
    if p.is_normalised:
        # All-zero features have no length; with any positive number they stay zero.
        floor_length = max(p.length_floor(layer), np.finfo(np.float32).tiny)
        arrays[f"{tap}_floor"] = np.array([floor_length], np.float32)
    floor = arrays.get(f"{tap}_floor")
    drawn = np.arange(len(layer) * len(cells))
    if len(drawn) > SAMPLES:
        drawn = np.sort(rng.choice(drawn, SAMPLES, replace=False))
    parts = np.split(drawn, np.searchsorted(drawn, np.arange(1, len(layer)) * len(cells)))
    sample = [_unit(press, floor, cells[part % len(cells)]) for press, part in zip(layer, parts, strict=True)]
    rotation = fit_rotation(np.concatenate(sample), dims)
    arrays[f"{tap}_mean"] = rotation.mean
    if rotation.basis is not None:
        arrays[f"{tap}_basis"] = rotation.basis
    arrays[f"{tap}_bank"] = np.stack(
        [rotation(_unit(press, floor, cells)).astype(np.float32) for press in layer]
    )
    return arrays


def _fit_gel(
    arrays: dict[str, NDArray[Any]],
    nominal: Nominal,
    pressed: NDArray[np.floating],
    grid: Grid,
    tap: str,
    p: SpadeParameters,
) -> float:
    """Adds `<tap>_gel`, and returns how far nominal frames are from it. pressed: the layer of the kept presses."""
    gel = arrays[f"{tap}_gel_cells"]
    frames = [np.stack([rows[gel] for rows in _rows(pressed, tap, arrays)])]
    if nominal.no_contact is not None:
        free = _average(nominal.no_contact[tap], grid, tap, p)
        frames.append(np.stack([rows[gel] for rows in _rows(free, tap, arrays)]))
    arrays[f"{tap}_gel"], scatter = gel_mean(frames[0], frames[1] if len(frames) > 1 else None)
    return scatter


def _unit(
    press: NDArray[np.floating], floor: NDArray[np.float32] | None, cells: NDArray[np.int64] | slice = EVERY
) -> NDArray[np.float64]:
    """The descriptors (cells, c) of one press (c, h, w), of unit length when there is a floor."""
    rows = press.reshape(len(press), -1)[:, cells].T.astype(np.float64, order="C")
    return rows if floor is None else rows / (np.sqrt(np.einsum("pc,pc->p", rows, rows))[:, None] + floor)


def _rows(
    layer: NDArray[np.floating], tap: str, arrays: Mapping[str, NDArray[Any]]
) -> list[NDArray[np.floating]]:
    """Each press's descriptors as the bank holds them, (cells, width)."""
    rotation = Rotation(arrays[f"{tap}_mean"], arrays.get(f"{tap}_basis"))
    return [rotation(_unit(press, arrays.get(f"{tap}_floor"))) for press in layer]


def _distances(
    rows: NDArray[np.floating],
    presses: NDArray[np.int64],
    arrays: Mapping[str, NDArray[Any]],
    tap: str,
    grid: Grid,
    p: SpadeParameters,
) -> NDArray[np.float64]:
    """Distances (tiles, h, w) of one press's descriptors to the gallery, or to the free gel in untouched cells."""
    distances = _search(rows, presses, arrays, tap, grid, p)
    if f"{tap}_gel" in arrays:
        gel = arrays[f"{tap}_gel_cells"]
        distances.reshape(-1)[gel] = gel_distances(
            rows[None, gel], arrays[f"{tap}_gel"], arrays[f"{tap}_gel_weight"]
        )[0]
    return distances


def _search(
    rows: NDArray[np.floating],
    presses: NDArray[np.int64],
    arrays: Mapping[str, NDArray[Any]],
    tap: str,
    grid: Grid,
    p: SpadeParameters,
) -> NDArray[np.float64]:
    """Distances (tiles, h, w) from one press's descriptors (cells, width) to the gallery of the named presses. They
    have no meaning at cells without rows."""
    h, w = p.cells(grid, tap)
    tiles = rows.reshape(-1, h, w, rows.shape[1])
    gallery = arrays[f"{tap}_bank"][presses]
    if f"{tap}_cells" in arrays:
        every = np.full((len(presses), len(rows), rows.shape[1]), np.inf, np.float32)
        every[:, arrays[f"{tap}_cells"]] = gallery
        gallery = every
    gallery = gallery.reshape(len(presses), *tiles.shape)
    window = p.window(grid, tap)
    if window is not None:
        return np.stack([window_nearest(tile, gallery[:, t], window) for t, tile in enumerate(tiles)])
    distances = []
    for t, tile in enumerate(tiles):
        searched = p.gallery_rows(gallery[:, t])
        distances.append(nearest(tile.reshape(h * w, -1), searched).distances.reshape(h, w))
    return np.stack(distances)


def _nominal_distance(arrays: Mapping[str, NDArray[Any]], tap: str, grid: Grid, p: SpadeParameters) -> float:
    """The median distance of a nominal press to the others at one layer; nan where there is one press."""
    described, bank = arrays["press_descriptors"], arrays[f"{tap}_bank"]
    count = p.count(grid, tap)
    stored = arrays.get(f"{tap}_cells", np.arange(count))
    presses = max(2, SCALE_CELLS // count)
    chosen = np.unique(np.linspace(0, len(described) - 1, min(presses, len(described))).astype(np.int64))
    medians = []
    for press in chosen:
        others = np.delete(np.arange(len(described)), press)
        if not len(others):
            return math.nan
        near = nearest(described[[press]], described[others], p.pixel_neighbours).indices[0]
        rows = np.zeros((count, bank.shape[2]))
        rows[stored] = bank[press]
        medians.append(np.median(_search(rows, others[near], arrays, tap, grid, p).reshape(-1)[stored]))
    return float(np.median(medians))


spade = Spade()
