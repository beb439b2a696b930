"""SPADE: the press is compared with its most similar nominal presses, place by place and at several scales.

Definition (Cohen and Hoshen, "Sub-image anomaly detection with deep pyramid correspondences", 2020): the K nominal
presses whose global descriptor is nearest give the gallery; a cell's score at one layer is its distance to the nearest
gallery cell of that layer; layers are averaged in pixels and blurred once. Read against byungjae89/SPADE-pytorch
@077c67b and the seed paper's scripts.

`paper` is that, with every gallery position allowed, unit-length descriptors and the chunked scan that loses up to
99 gallery cells. `corrected` looks at the finest layer as it is and only near the own place, keeps leading
principal directions and as many presses as the bank's size allows, none of them where no press touches, and scores a
press by its map.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from plugins.detectors.choices import bank_bytes, choose, repaired, require_fittable, require_scorable
from plugins.detectors.maths.coreset import k_centre
from plugins.detectors.maths.descriptor import resampling_matrix
from plugins.detectors.maths.distances import nearest
from plugins.detectors.maths.free_gel import (
    emit_gel_distances,
    gel_distances,
    gel_mean,
    gel_weight,
    touched_places,
)
from plugins.detectors.maths.layered import emit_layered_scores
from plugins.detectors.maths.mosaic import emit_join, emit_split, join, layout, split, stacked, tile_grid
from plugins.detectors.maths.rotation import Rotation, emit_rotation, fit_rotation
from plugins.detectors.maths.shortlist import PRODUCT_LIMIT, emit_group_nearest, emit_ranked
from plugins.detectors.maths.smoothing import PAPER_SIGMA_PX, Smoothing, Upsampling
from plugins.detectors.maths.window import Blocks, Tables, emit_window_nearest, window_nearest
from plugins.graph import Graph, Value

__all__ = ["SpadeParameters", "spade"]

# SPADE-pytorch src/main.py @077c67b: the gallery is scanned in chunks of this many cells.
CHUNK = 100
# The seed scripts divide a descriptor by its length plus this.
LENGTH_FLOOR = 1e-6
# Cells that a layer's leading directions are learnt from at most.
SAMPLES = 4096
EVERY = slice(None)
# Presses that tell how far apart nominal presses are at each layer.
SCALE_PRESSES = 12
# The paper's four pixels at 320x240, where a millimetre is 15.77 pixels.
SIGMA_MM = PAPER_SIGMA_PX / 15.77


@dataclass(frozen=True)
class SpadeParameters:
    """What SPADE can be told; every repair is a switch of its own.

    Measured as mean AU-PRO up to 1 % false positives and image AUROC on the development set (six random simulated
    parts, 24 nominal presses each), with tactile_resnet18 and, in brackets, untrained ResNet-18.

    layers: the taps compared, finest first. layer1 alone, dims 23: 0.752, 0.987 with 16 presses in the gallery; with
    layer2 on layer2's grid and unit length 0.66; layer1 to layer3 so 0.610, 0.975. descriptor: what stands for a whole
    press: the tap `avgpool`, the spatial means of the layers, or the first of these that the trunk gives.
    image_neighbours: presses that a press's own score is averaged over. pixel_neighbours: presses in the gallery (the
    two pull in opposite directions, so they are two); 5 stood at 0.759, 0.973 (0.619), 6 at 0.757, 0.980 (0.633), 8 at
    0.756, 0.982 (0.645), and the head's time grows with them. cell_mm: layers with smaller cells are averaged over
    2x2, 4x4 ... of them, as long as what results is no larger; None keeps all as they are. window_mm: how far from its
    own place a cell may be matched, None for anywhere: with dims 31 and 8 presses 0.25 stood at 0.751 (0.592), 0.5 at
    0.754 (0.643). dims: leading directions kept at each layer, plus the length of the rest, which makes multiples of
    eight whole; empty keeps all: 0.760 (0.632), 39 stood at 0.757 (0.633), 31 at 0.755 (0.632).
    is_normalised: descriptors divided by their length: 0.706, 0.975 with, where 0.752, 0.987 stood without.
    is_floor_relative: the term that keeps that division finite is a part of the nominal length, so that scaled
    features give the same map, instead of the absolute 1e-6.
    is_gallery_whole: every gallery cell is searched, instead of whole chunks of 100 only.
    is_balanced: each layer is divided by the median distance between nominal presses, so that none dominates
    by its scale. image_score: `map` is the maximum of the score map, `presses` the mean distance to the
    image neighbours. is_squared: those distances squared, as SPADE-fast has them.
    is_touched_only: cells that no nominal press touches (within margin_mm) keep no rows and are compared with the mean
    of the free gel; it needs a window. sigma: the blur, in `sigma_unit`. is_sampled: a cell's distance is drawn where
    its convolution looks, its top left pixel, instead of at the middle of a square. packing: of the stored cells.
    bank_mb: presses are left out (k-centre) beyond this many megabytes as stored at 224x224, up to four times as many
    for larger frames; None keeps all.
    """

    mode: Mode = "corrected"
    layers: tuple[str, ...] = ("layer1",)
    descriptor: Literal["auto", "avgpool", "means"] = "auto"
    image_neighbours: int = 5
    pixel_neighbours: int = 6
    cell_mm: float | None = 0.127
    window_mm: float | None = 0.5
    dims: tuple[int, ...] = (39,)
    is_normalised: bool = False
    is_floor_relative: bool = True
    is_gallery_whole: bool = True
    is_balanced: bool = True
    image_score: Literal["map", "presses"] = "map"
    is_squared: bool = False
    is_touched_only: bool = True
    margin_mm: float = 1.0
    sigma: float = SIGMA_MM
    sigma_unit: Literal["mm", "px"] = "mm"
    is_sampled: bool = True
    packing: Packing = "int8"
    bank_mb: float | None = 16.0

    def __post_init__(self) -> None:
        if not self.layers or len(set(self.layers)) != len(self.layers):
            raise ValueError(f"layers are different tap names, at least one, found {self.layers}")
        if self.image_neighbours < 1 or self.pixel_neighbours < 1:
            raise ValueError(
                f"neighbours are at least 1, found {self.image_neighbours} and {self.pixel_neighbours}"
            )
        if self.dims and (len(self.dims) != len(self.layers) or min(self.dims) < 1):
            raise ValueError(f"dims are one number per layer or none at all, found {self.dims}")
        if self.descriptor not in ("auto", "avgpool", "means") or self.image_score not in ("map", "presses"):
            raise ValueError(f"unknown descriptor '{self.descriptor}' or image_score '{self.image_score}'")
        if self.packing not in ("none", "float16", "int8") or self.sigma_unit not in ("mm", "px"):
            raise ValueError(
                f"packing is none, float16 or int8 and sigma_unit mm or px, found '{self.packing}', '{self.sigma_unit}'"
            )
        for name in ("cell_mm", "window_mm", "margin_mm", "sigma", "bank_mb"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is at least 0, found {value}")

    def smoothing(self, grid: Grid, tap: str) -> Smoothing:
        sigma_px = self.sigma * (grid.pixels_per_mm if self.sigma_unit == "mm" else 1.0)
        kind: Upsampling = "sampled" if self.is_sampled else "bilinear"
        (h, w), (down, across) = _cells(grid, tap, self), layout(grid)
        return Smoothing((down * h, across * w), grid.frame, sigma_px, kind, grid.tiles)


PAPER = SpadeParameters(
    mode="paper",
    layers=("layer1", "layer2", "layer3"),
    pixel_neighbours=5,
    cell_mm=None,
    window_mm=None,
    dims=(),
    is_normalised=True,
    is_floor_relative=False,
    is_gallery_whole=False,
    is_balanced=False,
    image_score="presses",
    is_touched_only=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
    bank_mb=None,
)


REPAIRS = (
    "window_mm",
    "is_normalised",
    "is_floor_relative",
    "is_gallery_whole",
    "is_balanced",
    "image_score",
    "is_touched_only",
    "is_sampled",
)
"""The switches that set the corrected mode apart; the others are operating points."""


class Spade:
    """SPADE under the entry points `gelgate.detectors`."""

    name = "spade"

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> SpadeParameters:
        """The mode's parameters with overrides. Errors: FitError."""
        return choose(self.name, PAPER if mode == "paper" else SpadeParameters(), overrides)

    def taps(self, parameters: SpadeParameters) -> tuple[str, ...]:
        """The layers, and `avgpool` where it is asked for by name."""
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
        `<tap>_weight`, `<tap>_floor`; for the whole press: `press_descriptors` (presses, d), `press_mean`. Where some
        cells are touched by no press: int64 `<tap>_cells` and `<tap>_gel_cells`, those with rows and the others,
        `<tap>_gel` (cells, width), `<tap>_gel_weight` (1,), and the search's tables `<tap>_queries`, `<tap>_reached`
        and `<tap>_order` (h * w,). Errors: FitError.
        """
        p = parameters
        require_fittable(
            self.name,
            nominal,
            grid,
            tuple(dict.fromkeys((*p.layers, *_descriptor_taps(grid, p)))),
            is_tileable=True,
        )
        described = _describe(nominal.features, grid, p)
        start = int(rng.integers(len(described)))
        stored = {tap: self._stored(nominal, grid, tap, p) for tap in p.layers}
        kept = _affordable(described, stored, grid, p, start)
        press_mean = described[kept].mean(axis=0).astype(np.float32)
        arrays: dict[str, NDArray[Any]] = {
            "press_descriptors": (described[kept] - press_mean).astype(np.float32),
            "press_mean": press_mean,
        }
        facts: dict[str, Any] = {
            "presses": kept.tolist(),
            "start": start,
            "repairs": repaired(p, PAPER, REPAIRS),
            "warnings": [],
        }
        if len(kept) < len(described):
            facts["warnings"].append(
                f"{len(kept)} of {len(described)} presses fit into bank_mb; the others are left out (k-centre)"
            )
        packing: dict[str, Packing] = {}
        for number, tap in enumerate(p.layers):
            layer = _averaged(nominal.features[tap][kept], grid, tap, p)
            dims = p.dims[number] if p.dims else None
            arrays |= _fit_layer(tap, layer, np.flatnonzero(stored[tap]), dims, p, rng)
            packing[f"{tap}_bank"] = p.packing
            gel = np.flatnonzero(~stored[tap])
            if len(gel):
                arrays |= {f"{tap}_cells": np.flatnonzero(stored[tap]), f"{tap}_gel_cells": gel}
                arrays |= {
                    f"{tap}_{name}": table for name, table in _tables(stored[tap], grid, tap, p).items()
                }
                # Never coarser than halves: their errors do not average out.
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

    def _stored(self, nominal: Nominal, grid: Grid, tap: str, p: SpadeParameters) -> NDArray[np.bool_]:
        """Which cells of a layer keep rows, flat, tile by tile."""
        cells = _cells(grid, tap, p)
        if not p.is_touched_only or _window(grid, tap, p) is None:
            return np.ones(math.prod(layout(grid)) * math.prod(cells), np.bool_)
        return touched_places(self.name, nominal, grid, cells, p.margin_mm)

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: SpadeParameters
    ) -> ScoreMaps:
        """The float64 oracle. Errors: NotScorable for features that are not finite."""
        p = parameters
        require_scorable(self.name, features, (*p.layers, *_descriptor_taps(grid, p)))
        described = _describe(features, grid, p) - bank.arrays["press_mean"]
        count = min(max(p.image_neighbours, p.pixel_neighbours), len(bank.arrays["press_descriptors"]))
        near = nearest(described, bank.arrays["press_descriptors"], count)
        score_map = np.zeros((len(described), *grid.frame))
        for tap in p.layers:
            raw = np.concatenate(
                [
                    _distances(row, near.indices[i, : p.pixel_neighbours], bank.arrays, tap, grid, p)
                    for i, row in enumerate(_rows(_averaged(features[tap], grid, tap, p), tap, bank.arrays))
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
        p = parameters
        graph = Graph(self.name)
        names = dict.fromkeys((*p.layers, *_descriptor_taps(grid, p)))
        taps = {tap: graph.input(tap, ("n", *grid.taps[tap])) for tap in names}
        squared, order = _emit_press_order(graph, taps, grid, p)
        gallery = _emit_first(graph, order, p.pixel_neighbours)
        maps = [_emit_layer(graph, tap, taps[tap], gallery, grid, bank, p) for tap in p.layers]
        score = None
        if p.image_score == "presses":
            best = _emit_first(graph, squared, p.image_neighbours)
            best = best if p.is_squared else graph.op("Sqrt", best)
            score = graph.op("ReduceMean", best, graph.ints(1), keepdims=0)
        smoothings = [p.smoothing(grid, tap) for tap in p.layers]
        emit_layered_scores(graph, maps, smoothings, score)
        return graph.serialise()


def _descriptor_taps(grid: Grid, p: SpadeParameters) -> tuple[str, ...]:
    """The taps whose spatial means describe a whole press (`avgpool` is its own mean)."""
    pooled = p.descriptor == "avgpool" or (p.descriptor == "auto" and "avgpool" in grid.taps)
    return ("avgpool",) if pooled else p.layers


def _describe(features: Features, grid: Grid, p: SpadeParameters) -> NDArray[np.float64]:
    """Global descriptors (n, d)."""
    means = [features[tap].mean(axis=(2, 3), dtype=np.float64) for tap in _descriptor_taps(grid, p)]
    return np.concatenate(means, axis=1)


def _cells(grid: Grid, tap: str, p: SpadeParameters) -> tuple[int, int]:
    """Rows and columns on which a layer is compared, of one tile where there are tiles."""
    tile = tile_grid(grid)
    h, w = tile.taps[tap][1:]
    if p.cell_mm is None:
        return h, w
    own_mm = min(tile.frame[0] / h, tile.frame[1] / w) / grid.pixels_per_mm
    # A hair below a power of two is one.
    side = 2 ** max(0, math.floor(math.log2(p.cell_mm / own_mm) + 0.01)) if p.cell_mm else 1
    return -(-h // side), -(-w // side)


def _averaging(
    grid: Grid, tap: str, p: SpadeParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """The matrices that average a layer onto its compared cells, None where it stays as it is."""
    own, cells = tile_grid(grid).taps[tap][1:], _cells(grid, tap, p)
    if own == cells:
        return None
    rows, columns = (resampling_matrix(n, to, p.is_sampled) for n, to in zip(own, cells, strict=True))
    return rows, columns


def _averaged(layer: NDArray[np.float32], grid: Grid, tap: str, p: SpadeParameters) -> NDArray[np.floating]:
    """A layer on the cells on which it is compared, tiles one under the other: (n, c, tiles * h, w)."""
    matrices = _averaging(grid, tap, p)
    if matrices is None:
        return stacked(layer, grid)
    tiles = matrices[0] @ split(layer, grid) @ matrices[1].T
    under = tiles.reshape(len(layer), -1, *tiles.shape[1:]).swapaxes(1, 2)
    return under.reshape(len(layer), tiles.shape[1], -1, tiles.shape[3])


def _window(grid: Grid, tap: str, p: SpadeParameters) -> int | None:
    """How many cells of a tap a match may be away; None for anywhere on the map."""
    if p.window_mm is None:
        return None
    cell_px = min(
        size / cells for size, cells in zip(tile_grid(grid).frame, _cells(grid, tap, p), strict=True)
    )
    # A hair under a whole number of cells must not become one cell more.
    cells = math.ceil(p.window_mm * grid.pixels_per_mm / cell_px - 1e-6)
    return cells if cells < max(_cells(grid, tap, p)) else None


def _affordable(
    described: NDArray[np.float64],
    stored: Mapping[str, NDArray[np.bool_]],
    grid: Grid,
    p: SpadeParameters,
    start: int,
) -> NDArray[np.int64]:
    """The presses that fit into the bank's size, rising; the most different ones where not all do."""
    if p.bank_mb is None:
        return np.arange(len(described))
    per_number, per_row = {"none": (4, 0), "float16": (2, 0), "int8": (1, 4)}[p.packing]
    press, fixed = 4 * described.shape[1], 4 * described.shape[1]
    for number, tap in enumerate(p.layers):
        channels, rows = grid.taps[tap][0], int(stored[tap].sum())
        width = min(p.dims[number] + 1, channels) if p.dims else channels
        # Besides the rows: mean, basis, floor, weights.
        fixed += 4 * (channels * width + channels + 3)
        press += rows * (width * per_number + per_row)
        gel = len(stored[tap]) - rows
        # Four bytes a number at most for the free gel, and the tables.
        fixed += (
            4 * width * gel + sum(table.nbytes for table in _tables(stored[tap], grid, tap, p).values())
            if gel
            else 0
        )
    count = max(1, (bank_bytes(p.bank_mb, grid) - fixed) // press)
    if count >= len(described):
        return np.arange(len(described))
    return np.sort(k_centre(described, count, start).rows)


def _tables(
    stored: NDArray[np.bool_], grid: Grid, tap: str, p: SpadeParameters
) -> dict[str, NDArray[np.int64]]:
    """What the search of a layer with some untouched cells is told. See `Spade.fit`."""
    tables = Tables.of(_blocks(grid, tap, p), np.flatnonzero(stored))
    order = np.empty(len(stored), np.int64)
    order[stored] = tables.back
    order[~stored] = tables.queries.size + np.arange((~stored).sum())
    return {"queries": tables.queries, "reached": tables.reached, "order": order}


def _blocks(grid: Grid, tap: str, p: SpadeParameters) -> Blocks:
    """The blocks in which a layer is searched; only with a window."""
    window = _window(grid, tap, p)
    assert window is not None
    return Blocks(_cells(grid, tap, p), window, math.prod(layout(grid)))


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
        length = _mean_length(layer) if p.is_floor_relative else 1.0
        # All-zero features have no length; any positive number then leaves them at zero.
        arrays[f"{tap}_floor"] = np.array([max(LENGTH_FLOOR * length, np.finfo(np.float32).tiny)], np.float32)
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
    """Adds `<tap>_gel`, and gives how far nominal frames lie from it. pressed: the layer of the kept presses."""
    gel = arrays[f"{tap}_gel_cells"]
    frames = [np.stack([rows[gel] for rows in _rows(pressed, tap, arrays)])]
    if nominal.no_contact is not None:
        free = _averaged(nominal.no_contact[tap], grid, tap, p)
        frames.append(np.stack([rows[gel] for rows in _rows(free, tap, arrays)]))
    arrays[f"{tap}_gel"], scatter = gel_mean(frames[0], frames[1] if len(frames) > 1 else None)
    return scatter


def _mean_length(layer: NDArray[np.floating]) -> float:
    """The mean Euclidean length of a cell's descriptor, of features (n, c, h, w)."""
    return float(np.mean([np.sqrt(np.square(press, dtype=np.float64).sum(axis=0)).mean() for press in layer]))


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
    """Distances (tiles, h, w) of one press's descriptors to the gallery, or to the free gel where none touches."""
    found = _search(rows, presses, arrays, tap, grid, p)
    if f"{tap}_gel" in arrays:
        gel = arrays[f"{tap}_gel_cells"]
        found.reshape(-1)[gel] = gel_distances(
            rows[None, gel], arrays[f"{tap}_gel"], arrays[f"{tap}_gel_weight"]
        )[0]
    return found


def _search(
    rows: NDArray[np.floating],
    presses: NDArray[np.int64],
    arrays: Mapping[str, NDArray[Any]],
    tap: str,
    grid: Grid,
    p: SpadeParameters,
) -> NDArray[np.float64]:
    """Distances (tiles, h, w) from one press's descriptors (cells, width) to the gallery of the named presses; of no
    meaning at cells without rows."""
    h, w = _cells(grid, tap, p)
    tiles = rows.reshape(-1, h, w, rows.shape[1])
    gallery = arrays[f"{tap}_bank"][presses]
    if f"{tap}_cells" in arrays:
        every = np.full((len(presses), len(rows), rows.shape[1]), np.inf, np.float32)
        every[:, arrays[f"{tap}_cells"]] = gallery
        gallery = every
    gallery = gallery.reshape(len(presses), *tiles.shape)
    window = _window(grid, tap, p)
    if window is not None:
        return np.stack([window_nearest(tile, gallery[:, t], window) for t, tile in enumerate(tiles)])
    found = []
    for t, tile in enumerate(tiles):
        flat = gallery[:, t].reshape(-1, rows.shape[1])
        found.append(
            nearest(tile.reshape(h * w, -1), flat[: _searched(len(flat), p)]).distances.reshape(h, w)
        )
    return np.stack(found)


def _searched(cells: int, p: SpadeParameters) -> int:
    """How many gallery cells are searched: all, or whole chunks only (a gallery below one chunk is searched whole)."""
    return cells if p.is_gallery_whole or cells < CHUNK else cells // CHUNK * CHUNK


def _nominal_distance(arrays: Mapping[str, NDArray[Any]], tap: str, grid: Grid, p: SpadeParameters) -> float:
    """The median distance of a nominal press to the others at one layer; nan where there is one press."""
    described, bank = arrays["press_descriptors"], arrays[f"{tap}_bank"]
    count = math.prod(layout(grid)) * math.prod(_cells(grid, tap, p))
    stored = arrays.get(f"{tap}_cells", np.arange(count))
    chosen = np.unique(np.linspace(0, len(described) - 1, SCALE_PRESSES).astype(np.int64))
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


def _emit_first(graph: Graph, values: Value, count: int) -> Value:
    """The first `count` columns, or all where there are fewer."""
    return graph.op("Slice", values, graph.ints(0), graph.ints(count), graph.ints(1))


def _emit_press_order(
    graph: Graph, taps: Mapping[str, Value], grid: Grid, p: SpadeParameters
) -> tuple[Value, Value]:
    """Squared distances (n, k) to the nearest presses, rising, and their numbers."""
    names = _descriptor_taps(grid, p)
    width = sum(grid.taps[tap][0] for tap in names)
    means = [graph.op("ReduceMean", taps[tap], graph.ints(2, 3), keepdims=0) for tap in names]
    described = graph.op(
        "Sub",
        graph.op("Concat", *means, axis=1) if len(means) > 1 else means[0],
        graph.input("press_mean", (width,)),
    )
    presses = graph.input("press_descriptors", ("presses", width))
    difference = graph.op("Sub", graph.op("Unsqueeze", described, graph.ints(1)), presses)
    squared = graph.op("ReduceSum", graph.op("Mul", difference, difference), graph.ints(2), keepdims=0)
    wanted = graph.ints(max(p.image_neighbours, p.pixel_neighbours))
    count = graph.op("Min", wanted, graph.op("Shape", presses, start=0, end=1))
    nearest_squared, order = graph.ops("TopK", 2, squared, count, axis=1, largest=0)
    return nearest_squared, order


def _emit_layer(
    graph: Graph, tap: str, layer: Value, gallery: Value, grid: Grid, bank: Bank, p: SpadeParameters
) -> Value:
    """Weighted distances (n, rows, columns) of one layer to the gallery's presses (n, k)."""
    c, (h, w) = grid.taps[tap][0], _cells(grid, tap, p)
    tiles = math.prod(layout(grid))
    layer = emit_split(graph, layer, grid.taps[tap], grid)
    matrices = _averaging(grid, tap, p)
    if matrices is not None:
        down, across = (
            graph.constant(np.ascontiguousarray(m, np.float32)) for m in (matrices[0], matrices[1].T)
        )
        layer = graph.op("MatMul", down, graph.op("MatMul", layer, across))
    columns = graph.reshape(layer, 0, c, h * w)
    if p.is_normalised:
        length = graph.op("ReduceL2", columns, graph.ints(1), keepdims=1)
        columns = graph.op("Div", columns, graph.op("Add", length, graph.input(f"{tap}_floor", (1,))))
    mean = graph.input(f"{tap}_mean", (c,))
    basis = bank.arrays.get(f"{tap}_basis")
    width = c if basis is None else len(basis) + 1
    rows = emit_rotation(
        graph, columns, mean, None if basis is None else graph.input(f"{tap}_basis", basis.shape)
    )
    rows = graph.reshape(rows, -1, tiles * h * w, width)
    if _window(grid, tap, p) is None:
        presses = graph.input(f"{tap}_bank", ("presses", tiles * h * w, width))
        distances = _emit_whole_search(graph, rows, presses, gallery, (tiles, h * w, width), p)
    else:
        distances = _emit_windows(graph, tap, rows, gallery, grid, bank, p)
    weight = graph.input(f"{tap}_weight", (1,))
    weighted = graph.op("Mul", graph.reshape(distances, -1, h, w), weight)
    return emit_join(graph, weighted, (h, w), grid)


def _emit_windows(
    graph: Graph, tap: str, rows: Value, gallery: Value, grid: Grid, bank: Bank, p: SpadeParameters
) -> Value:
    """Distances (n, tiles * cells) to the gallery within the windows, and to the free gel where no press touches."""
    cells, width = (
        math.prod(layout(grid)) * math.prod(_cells(grid, tap, p)),
        bank.arrays[f"{tap}_bank"].shape[2],
    )
    blocks, size = _blocks(grid, tap, p), (width, p.pixel_neighbours)
    if f"{tap}_gel" not in bank.arrays:
        tables = Tables.of(blocks, np.arange(cells))
        presses = graph.input(f"{tap}_bank", ("presses", cells, width))
        values = graph.constant(tables.queries), graph.constant(tables.reached)
        found = emit_window_nearest(graph, rows, presses, gallery, blocks, values, size)
        return graph.op("Gather", found, graph.constant(tables.back), axis=1)
    presses = graph.input(f"{tap}_bank", ("presses", f"{tap}_stored", width))
    queries, reached = (
        graph.input(f"{tap}_{name}", (f"{tap}_blocks", bank.arrays[f"{tap}_{name}"].shape[1]), "int64")
        for name in ("queries", "reached")
    )
    found = emit_window_nearest(graph, rows, presses, gallery, blocks, (queries, reached), size)
    count = f"{tap}_untouched"
    here = graph.op("Gather", rows, graph.input(f"{tap}_gel_cells", (count,), "int64"), axis=1)
    mean, weight = graph.input(f"{tap}_gel", (count, width)), graph.input(f"{tap}_gel_weight", (1,))
    both = graph.op("Concat", found, emit_gel_distances(graph, here, mean, weight), axis=1)
    return graph.op("Gather", both, graph.input(f"{tap}_order", (cells,), "int64"), axis=1)


def _emit_whole_search(
    graph: Graph, rows: Value, presses: Value, gallery: Value, size: tuple[int, int, int], p: SpadeParameters
) -> Value:
    """Distances (n * tiles, cells, 1) to any gallery cell of the same tile, so many rows at a time that memory stays
    bounded. size: tiles, cells of one, width."""
    tiles, cells, width = size
    count = graph.op("Mul", graph.op("Shape", gallery, start=1, end=2), graph.ints(cells))
    found = graph.reshape(graph.op("Gather", presses, gallery, axis=0), 0, 0, tiles, cells, width)
    shape = graph.op("Concat", graph.ints(-1), count, graph.ints(width), axis=0)
    bank = graph.op("Reshape", graph.transpose(found, 0, 2, 1, 3, 4), shape)
    rows = graph.reshape(rows, -1, cells, width)
    if not p.is_gallery_whole:
        total = graph.op("Shape", bank, start=1, end=2)
        whole = graph.op("Mul", graph.op("Div", total, graph.ints(CHUNK)), graph.ints(CHUNK))
        small = graph.op("Less", total, graph.ints(CHUNK))
        bank = graph.op("Slice", bank, graph.ints(0), graph.op("Where", small, total, whole), graph.ints(1))
    bank = emit_ranked(graph, bank)
    step = max(1, PRODUCT_LIMIT // (p.pixel_neighbours * cells))
    parts = [
        emit_group_nearest(
            graph,
            graph.op("Slice", rows, graph.ints(first), graph.ints(first + step), graph.ints(1)),
            bank,
            width,
        )
        for first in range(0, cells, step)
    ]
    return graph.op("Concat", *parts, axis=1) if len(parts) > 1 else parts[0]


spade = Spade()
