"""SPADE: the press is compared with its most similar nominal presses, place by place and at several scales.

Definition (Cohen and Hoshen, "Sub-image anomaly detection with deep pyramid correspondences", 2020): the K nominal
presses whose global descriptor is nearest give the gallery; a cell's score at one layer is its distance to the nearest
gallery cell of that layer; layers are averaged in pixels and blurred once. Read against byungjae89/SPADE-pytorch
@077c67b and the seed paper's scripts.

`paper` is that, with every gallery position allowed, unit-length descriptors and the chunked scan that loses up to
99 gallery cells. `corrected` looks only near the own place, gives every layer the same weight, keeps leading
principal directions and as many presses as the bank's size allows, and scores a press by its map.
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
from plugins.detectors.maths.layered import emit_layered_scores
from plugins.detectors.maths.mosaic import emit_join, emit_split, join, layout, split, stacked, tile_grid
from plugins.detectors.maths.rotation import Rotation, emit_rotation, fit_rotation
from plugins.detectors.maths.shortlist import (
    PRODUCT_LIMIT,
    Blocks,
    emit_group_nearest,
    emit_ranked,
    emit_window_nearest,
    window_nearest,
)
from plugins.detectors.maths.smoothing import PAPER_SIGMA_PX, Smoothing, Upsampling
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

    layers: the taps compared, finest first. descriptor: what stands for a whole press: the tap `avgpool`, the spatial
    means of the layers, or the first of these that the trunk gives. image_neighbours: presses that a press's own
    score is averaged over. pixel_neighbours: presses in the gallery (the two pull in opposite directions, so
    they are two). finest: layers with more cells than this tap are averaged onto its grid; None keeps all as they are.
    window_mm: how far from its own place a cell may be matched, None for anywhere. dims: leading
    directions kept at each layer, plus the length of the rest, which makes multiples of eight whole; empty keeps all.
    is_normalised: descriptors divided by their length. is_floor_relative: the term that keeps that division finite is a
    part of the nominal length, so that scaled features give the same map, instead of the absolute 1e-6.
    is_gallery_whole: every gallery cell is searched, instead of whole chunks of 100 only.
    is_balanced: each layer is divided by the median distance between nominal presses, so that none dominates
    by its scale. image_score: `map` is the maximum of the score map, `presses` the mean distance to the
    image neighbours. is_squared: those distances squared, as SPADE-fast has them.
    sigma: the blur, in `sigma_unit`. is_sampled: a cell's distance is drawn where its convolution looks, its top left
    pixel, instead of at the middle of a square. packing: of the stored cells. bank_mb: presses are left out (k-centre)
    beyond this many megabytes as stored at 224x224, up to four times as many for larger frames; None keeps all.
    """

    mode: Mode = "corrected"
    layers: tuple[str, ...] = ("layer1", "layer2", "layer3")
    descriptor: Literal["auto", "avgpool", "means"] = "auto"
    image_neighbours: int = 5
    pixel_neighbours: int = 16
    finest: str | None = "layer2"
    window_mm: float | None = 0.5
    dims: tuple[int, ...] = (23, 47, 95)
    is_normalised: bool = True
    is_floor_relative: bool = True
    is_gallery_whole: bool = True
    is_balanced: bool = True
    image_score: Literal["map", "presses"] = "map"
    is_squared: bool = False
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
        for name in ("window_mm", "sigma", "bank_mb"):
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
    pixel_neighbours=5,
    finest=None,
    window_mm=None,
    dims=(),
    is_floor_relative=False,
    is_gallery_whole=False,
    is_balanced=False,
    image_score="presses",
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
    bank_mb=None,
)


REPAIRS = ("window_mm", "is_floor_relative", "is_gallery_whole", "is_balanced", "image_score", "is_sampled")
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
        `<tap>_weight`, `<tap>_floor`; for the whole press: `press_descriptors` (presses, d), `press_mean`.
        Errors: FitError.
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
        kept = _affordable(described, grid, p, start)
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
        for number, tap in enumerate(p.layers):
            layer = _averaged(nominal.features[tap][kept], grid, tap, p)
            arrays |= _fit_layer(tap, layer, p.dims[number] if p.dims else None, p, rng)
            arrays[f"{tap}_weight"] = np.array([1 / len(p.layers)], np.float32)
            if p.is_balanced:
                scale = _nominal_distance(arrays, tap, grid, p)
                arrays[f"{tap}_weight"] /= np.float32(scale)
                facts[f"{tap}_nominal_distance"] = scale
            progress((number + 1) / len(p.layers))
        return Bank(arrays, {f"{tap}_bank": p.packing for tap in p.layers}, facts)

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
                    _search(row, near.indices[i, : p.pixel_neighbours], bank.arrays, tap, grid, p)
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
    taps = tile_grid(grid).taps
    h, w = taps[tap][1:]
    if p.finest is None or p.finest not in taps:
        return h, w
    return min(h, taps[p.finest][1]), min(w, taps[p.finest][2])


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
    described: NDArray[np.float64], grid: Grid, p: SpadeParameters, start: int
) -> NDArray[np.int64]:
    """The presses that fit into the bank's size, rising; the most different ones where not all do."""
    if p.bank_mb is None:
        return np.arange(len(described))
    itemsize = {"none": 4, "float16": 2, "int8": 1}[p.packing]
    size = 4 * described.shape[1]
    for number, tap in enumerate(p.layers):
        channels, (h, w) = grid.taps[tap][0], _cells(grid, tap, p)
        width = min(p.dims[number] + 1, channels) if p.dims else channels
        size += math.prod(layout(grid)) * h * w * width * itemsize
    count = max(1, bank_bytes(p.bank_mb, grid) // size)
    if count >= len(described):
        return np.arange(len(described))
    return np.sort(k_centre(described, count, start).rows)


def _fit_layer(
    tap: str, layer: NDArray[np.floating], dims: int | None, p: SpadeParameters, rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """The arrays of one layer from its nominal features (n, c, h, w)."""
    arrays: dict[str, NDArray[Any]] = {}
    if p.is_normalised:
        length = _mean_length(layer) if p.is_floor_relative else 1.0
        # All-zero features have no length; any positive number then leaves them at zero.
        arrays[f"{tap}_floor"] = np.array([max(LENGTH_FLOOR * length, np.finfo(np.float32).tiny)], np.float32)
    floor = arrays.get(f"{tap}_floor")
    cells = layer.shape[2] * layer.shape[3]
    drawn = np.arange(len(layer) * cells)
    if len(drawn) > SAMPLES:
        drawn = np.sort(rng.choice(drawn, SAMPLES, replace=False))
    parts = np.split(drawn, np.searchsorted(drawn, np.arange(1, len(layer)) * cells))
    sample = [_unit(press, floor, part % cells) for press, part in zip(layer, parts, strict=True)]
    rotation = fit_rotation(np.concatenate(sample), dims)
    arrays[f"{tap}_mean"] = rotation.mean
    if rotation.basis is not None:
        arrays[f"{tap}_basis"] = rotation.basis
    arrays[f"{tap}_bank"] = np.stack([rotation(_unit(press, floor)).astype(np.float32) for press in layer])
    return arrays


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


def _search(
    rows: NDArray[np.floating],
    presses: NDArray[np.int64],
    arrays: Mapping[str, NDArray[Any]],
    tap: str,
    grid: Grid,
    p: SpadeParameters,
) -> NDArray[np.float64]:
    """Distances (tiles, h, w) from one press's descriptors (cells, width) to the gallery of the named presses."""
    h, w = _cells(grid, tap, p)
    tiles = rows.reshape(-1, h, w, rows.shape[1])
    gallery = arrays[f"{tap}_bank"][presses].reshape(len(presses), *tiles.shape)
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
    """The median distance of a nominal press to the others at one layer; 1 where that is zero or there is one press."""
    described = arrays["press_descriptors"]
    chosen = np.unique(np.linspace(0, len(described) - 1, SCALE_PRESSES).astype(np.int64))
    medians = []
    for press in chosen:
        others = np.delete(np.arange(len(described)), press)
        if not len(others):
            return 1.0
        near = nearest(described[[press]], described[others], p.pixel_neighbours).indices[0]
        rows = arrays[f"{tap}_bank"][press].astype(np.float64)
        medians.append(np.median(_search(rows, others[near], arrays, tap, grid, p)))
    middle = float(np.median(medians))
    return middle if middle > 0 else 1.0


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
    presses = graph.input(f"{tap}_bank", ("presses", tiles * h * w, width))
    window = _window(grid, tap, p)
    if window is None:
        distances = _emit_whole_search(graph, rows, presses, gallery, (tiles, h * w, width), p)
    else:
        blocks = Blocks((h, w), window, tiles, width)
        distances = emit_window_nearest(graph, rows, presses, gallery, blocks, width, p.pixel_neighbours)
    weight = graph.input(f"{tap}_weight", (1,))
    weighted = graph.op("Mul", graph.reshape(distances, -1, h, w), weight)
    return emit_join(graph, weighted, (h, w), grid)


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
