"""FAPM: a few prototypes for each place, more of them where nominal presses vary more.

Definition (Kim, Park, Cho and Lee, "FAPM: Fast adaptive patch memory for real-time industrial anomaly detection",
ICASSP 2023), read against eastbrother87/FAPM_official @5d2d2f2, which scores but does not fit, and the seed paper's
scripts, which fit. Two layers are averaged over 3x3 cells. The grid is cut into cells of 4x4 fine and 2x2 coarse
sub-patches (32 px). k-centre keeps 10 % of the nominal descriptors (near) or twice as many (far). The distances to the
nearest prototypes of both layers are added.

Which cells get the far bank is not public. Here it is the upper tenth of the cells of each layer, by how far a nominal
descriptor is from its near bank (the seed scripts' rule).

`corrected` uses the finest layer alone, without averaging, and keeps no prototypes where no nominal press touches.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64, Mask
from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from edge.core.errors import FitError
from plugins.detectors.common.parameters import Rng, choose, list_repairs
from plugins.detectors.common.smoothing import emit_scores
from plugins.detectors.common.tile_layout import emit_join, emit_split, join, layout, split, tile_grid
from plugins.detectors.common.untouched_places import gel_mean, gel_weight, touched_places
from plugins.detectors.common.validation import bank_bytes, require_fittable, require_scorable
from plugins.detectors.fapm.paper import PAPER, REPAIRS
from plugins.detectors.fapm.parameters import COARSE_SIDE, FINE_SIDE, FapmParameters
from plugins.detectors.fapm.prototypes import (
    Layout,
    cell_layout,
    cell_scales,
    choose_prototypes,
    emit_prototype_distances,
    prototype_distances,
)
from plugins.onnx_builder import Graph, Value

__all__ = ["FapmParameters", "fapm"]

# Where distances are calibrated: smaller scales of cells are raised to this quantile of all scales, so that calibration
# lowers only the cells that vary most. With a low quantile, gel that most presses do not touch had the highest scores.
# On two simulated parts AU-PRO@0.01 was 0.15 and 0.00 at 0.05, 0.11 and 0.19 at 0.75, 0.05 and 0.13 uncalibrated
# (layer2 and layer3 of untrained weights).
SCALE_FLOOR_QUANTILE = 0.75
# Bytes of a number as stored.
BYTES: Mapping[Packing, int] = {"none": 4, "float16": 2, "int8": 1}
# int8 keeps one float32 scale per row.
SCALE_BYTES = 4


class Fapm:
    """FAPM under the entry points `gelgate.detectors`."""

    name = "fapm"
    compares_places = True
    is_baseline = False
    keeps_mean = True

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> FapmParameters:
        return choose(self.name, PAPER if mode == "paper" else FapmParameters(), PAPER, overrides)

    def taps(self, parameters: FapmParameters) -> tuple[str, ...]:
        return parameters.layers

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: FapmParameters, rng: Rng, progress: Progress
    ) -> Bank:
        """Prototypes per group of sub-patches. Arrays per layer and kind, near and far: `<tap>_near` (groups,
        prototypes, c), centred; `<tap>_near_mean` (groups, c); `<tap>_near_places` int64 (groups, s). Per layer:
        `<tap>_order` int64 (h * w,), the index of a place among those of near, far and gel; `<tap>_weight` (h * w,)
        where calibrated. Where no press touches some places: `<tap>_gel` (places, c), `<tap>_gel_places`,
        `<tap>_gel_weight` (1,). Errors: FitError.
        """
        p = parameters
        require_fittable(self.name, nominal, grid, p.layers)
        _require_halved(grid, p)
        # One start for every group.
        start = float(rng.random())
        kept = {tap: self._find_kept(nominal, grid, tap, p) for tap in p.layers}
        fraction = _affordable(nominal, kept, grid, p)
        arrays: dict[str, NDArray[Any]] = {}
        facts: dict[str, Any] = {"start": start, "near_fraction": fraction}
        facts |= {"repairs": list_repairs(p, PAPER, REPAIRS), "warnings": []}
        if fraction < p.near_fraction:
            facts["warnings"].append(
                f"near_fraction {fraction:.3f} instead of {p.near_fraction} keeps the bank within "
                f"{bank_bytes(p.bank_mb, grid) / 1e6:g} MB"
            )
        for number, tap in enumerate(p.layers):
            layer, learnt = _fit_layer(nominal, tap, grid, kept[tap], fraction, start, p)
            arrays |= {f"{tap}_{name}": array for name, array in layer.items()}
            facts |= {f"{tap}_{name}": value for name, value in learnt.items()}
            progress((number + 1) / len(p.layers))
        if p.weighting != "none" and fewest(arrays, p) < 2:
            facts["warnings"].append(
                "one prototype per group: there is no second neighbour to weight a score by"
            )
        return Bank(arrays, _packing(arrays, grid, p), facts)

    def _find_kept(self, nominal: Nominal, grid: Grid, tap: str, p: FapmParameters) -> Mask:
        """Which groups of a tap keep prototypes: those with a touched place, or all."""
        groups = _layout(grid, tap, p).groups
        if not p.is_touched_only:
            return np.ones(len(groups), bool)
        cells = tile_grid(grid).taps[tap][1:]
        touched = touched_places(nominal, grid, cells, p.margin_mm)
        return np.asarray(touched[groups].any(axis=1), np.bool_)

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: FapmParameters
    ) -> ScoreMaps:
        p = parameters
        require_scorable(self.name, features, p.layers)
        each = [
            _layer_distances(_pool(features[tap].astype(np.float64), grid, p.pooling), tap, bank.arrays, p)
            for tap in p.layers
        ]
        fused = each[0] if len(each) == 1 else each[0] + each[1][:, coarse_of_fine(grid, p)]
        smoothing = p.smoothing(grid)
        cells = tile_grid(grid).taps[p.layers[0]][1:]
        maps = smoothing.score_maps(join(fused[:, :, 0].reshape(-1, *cells), grid))
        if p.weighting == "none":
            return maps
        top = fused[:, :, 0].argmax(axis=1)
        neighbours = fused[np.arange(len(fused)), top]
        if is_unweighted(bank.arrays, p):
            return ScoreMaps(maps.score_map, neighbours[:, 0])
        return ScoreMaps(maps.score_map, neighbours[:, 0] * p.weigh(neighbours))

    def head(self, grid: Grid, bank: Bank, parameters: FapmParameters) -> bytes:
        """The graph; the number of prototypes is free."""
        p, graph = parameters, Graph(self.name)
        fused = _emit_layer(graph, p.layers[0], grid, bank, p)
        if len(p.layers) == 2:
            coarse = _emit_layer(graph, p.layers[1], grid, bank, p)
            above = graph.op("Gather", coarse, graph.constant(coarse_of_fine(grid, p)), axis=1)
            fused = graph.op("Add", fused, above)
        nearest_of = graph.first(fused, 2)
        score = None
        if p.weighting != "none":
            top = graph.op("ArgMax", nearest_of, axis=1, keepdims=1)
            neighbours = graph.op("GatherND", fused, top, batch_dims=1)
            score = graph.first(neighbours, 1)
            if not is_unweighted(bank.arrays, p):
                score = graph.op("Mul", score, p.emit_weight(graph, neighbours))
        cells = tile_grid(grid).taps[p.layers[0]][1:]
        joined = emit_join(graph, graph.reshape(nearest_of, -1, *cells), cells, grid)
        emit_scores(graph, joined, p.smoothing(grid), score)
        return graph.serialise()


fapm = Fapm()


def _require_halved(grid: Grid, p: FapmParameters) -> None:
    if len(p.layers) == 1:
        return
    fine, coarse = (tile_grid(grid).taps[tap][1:] for tap in p.layers)
    if tuple(-(-n // 2) for n in fine) != coarse:
        raise FitError(
            f"fapm: '{p.layers[1]}' is {coarse}, half of '{p.layers[0]}' would be {tuple(-(-n // 2) for n in fine)}; "
            "choose two layers that follow each other"
        )


def _layout(grid: Grid, tap: str, p: FapmParameters) -> Layout:
    side = FINE_SIDE if tap == p.layers[0] else COARSE_SIDE
    return cell_layout(shape_of(grid, tap), side, p.banks == "cell")


def _pool(layer: NDArray[np.floating], grid: Grid, side: int) -> NDArray[np.floating]:
    """Average over side x side cells, with zeros beyond the border of a tile: (n, c, H, W) to rows (n, places, c)."""
    maps = split(layer, grid)
    h, w = maps.shape[2:]
    if side > 1:
        padded = np.pad(maps, ((0, 0), (0, 0), (side // 2, side // 2), (side // 2, side // 2)))
        down = sum(padded[:, :, step : step + h] for step in range(1, side)) + padded[:, :, :h]
        across = sum(down[..., step : step + w] for step in range(1, side)) + down[..., :w]
        maps = across / across.dtype.type(side * side)
    rows: NDArray[np.floating] = np.swapaxes(maps.reshape(*maps.shape[:2], -1), 1, 2)
    return rows.reshape(len(layer), -1, rows.shape[2])


def _fit_layer(
    nominal: Nominal,
    tap: str,
    grid: Grid,
    kept: Mask,
    fraction: float,
    start: float,
    p: FapmParameters,
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """The arrays of one layer, and facts of the fit. kept: bool (groups,), those with prototypes."""
    rows = _pool(nominal.features[tap], grid, p.pooling)
    places = _layout(grid, tap, p).only(kept)
    near, far = _counts(nominal.presses * places.groups.shape[1], fraction, p)
    chosen = choose_prototypes(rows, places, (near, far), p.far_quantile, start)
    arrays: dict[str, NDArray[Any]] = {}
    for kind, members, count in (("near", ~chosen.is_far, near), ("far", chosen.is_far, far)):
        if members.any():
            arrays[kind] = np.ascontiguousarray(chosen.rows[members, :count])
            arrays[f"{kind}_mean"] = chosen.mean[members]
            arrays[f"{kind}_places"] = places.groups[members]
    scales = cell_scales(chosen.apart, places.cell, SCALE_FLOOR_QUANTILE) if p.is_calibrated else None
    gel = np.setdiff1d(np.arange(rows.shape[1]), places.groups)
    if len(gel):
        free = None
        if nominal.no_contact is not None:
            free = _pool(nominal.no_contact[tap], grid, p.pooling)[:, gel]
        arrays["gel"], scatter = gel_mean(rows[:, gel], free)
        known = chosen.apart[np.isfinite(chosen.apart)]
        usual = float(np.median(known)) if known.size else math.nan
        weight = gel_weight(scatter, usual) if scales is None else 1 / max(scales.min(), scatter)
        arrays["gel_weight"] = np.array([weight], np.float32)
        arrays["gel_places"] = gel
    if scales is not None:
        arrays["weight"] = np.ones(rows.shape[1], np.float32)
        arrays["weight"][places.groups] = (1 / scales)[:, None]
    where = [
        arrays[f"{kind}_places"].ravel() for kind in ("near", "far", "gel") if f"{kind}_places" in arrays
    ]
    # Of a place that its cell repeats at the border the first copy is used.
    arrays["order"] = np.unique(np.concatenate(where), return_index=True)[1]
    learnt = {"near_prototypes": near, "far_prototypes": far, "far_groups": int(chosen.is_far.sum())}
    return arrays, learnt | {"groups": len(places.groups), "gel_places": len(gel)}


def _counts(rows: int, fraction: float, p: FapmParameters) -> tuple[int, int]:
    """Numbers of near and far prototypes for a group's number of nominal rows."""
    near = max(1, int(fraction * rows))
    return near, min(max(near, int(p.far_factor * near)), rows)


def _affordable(nominal: Nominal, kept: Mapping[str, Mask], grid: Grid, p: FapmParameters) -> float:
    """near_fraction, or, with packing "auto", the largest part of it with which int8 stays within `bank_mb`."""
    if p.packing != "auto":
        return p.near_fraction
    wanted = fixed = 0.0
    for tap, groups in kept.items():
        c, places = grid.taps[tap][0], _layout(grid, tap, p)
        s, cells = places.groups.shape[1], len(np.unique(places.cell[groups]))
        near, far = _counts(nominal.presses * s, p.near_fraction, p)
        # Cells at or above the quantile of their reach.
        share = 1 - math.ceil(p.far_quantile * (cells - 1)) / cells
        per_group = near + share * (far - near)
        wanted += groups.sum() * per_group * (c + SCALE_BYTES)
        # Means, tables of places, and the free gel.
        fixed += groups.sum() * (4 * c + 16 * s) + (~groups).sum() * s * (2 * c + 16)
    room = nominal.room * max(bank_bytes(p.bank_mb, grid) - fixed, 0.0)
    return p.near_fraction * min(1.0, room / wanted)


def _packing(arrays: Mapping[str, NDArray[Any]], grid: Grid, p: FapmParameters) -> dict[str, Packing]:
    """Choose how the prototypes are stored; the free gel's means are never coarser than float16."""
    if p.packing == "none":
        return {}
    means: dict[str, Packing] = {name: "float16" for name in arrays if name.endswith("_gel")}
    names = [f"{tap}_{kind}" for tap in p.layers for kind in ("near", "far") if f"{tap}_{kind}" in arrays]
    numbers = sum(arrays[name].size for name in names)
    rest = sum(array.nbytes for name, array in arrays.items() if name not in names)
    packing = p.packing
    if packing == "auto":
        packing = "float16" if BYTES["float16"] * numbers + rest <= bank_bytes(p.bank_mb, grid) else "int8"
    return {**means, **dict.fromkeys(names, packing)}


def _layer_distances(
    rows: NDArray[np.floating], tap: str, arrays: Mapping[str, NDArray[Any]], p: FapmParameters
) -> F64:
    """Distances (n, h * w, neighbours) of one layer's rows (n, h * w, c), calibrated."""
    distances = prototype_distances(rows, tap, arrays, p.looked_at)
    if p.is_calibrated:
        distances *= arrays[f"{tap}_weight"].astype(np.float64)[:, None]
    return distances


def is_unweighted(arrays: Mapping[str, NDArray[Any]], p: FapmParameters) -> bool:
    """Tell whether the score has no weight because there is no second neighbour."""
    return min(p.neighbours, fewest(arrays, p)) < p.least_weighted


def fewest(arrays: Mapping[str, NDArray[Any]], p: FapmParameters) -> int:
    """Prototypes in the smallest group."""
    kinds = [f"{tap}_{kind}" for tap in p.layers for kind in ("near", "far")]
    return min(int(arrays[name].shape[1]) for name in kinds if name in arrays)


def shape_of(grid: Grid, tap: str) -> tuple[int, int]:
    """Rows and columns of a tap's sub-patches, tiles one under the other."""
    _, h, w = tile_grid(grid).taps[tap]
    return math.prod(layout(grid)) * h, w


def coarse_of_fine(grid: Grid, p: FapmParameters) -> NDArray[np.int64]:
    """Which coarse sub-patch each fine one gets: int64 (fine h * w,)."""
    (fine_h, fine_w), (coarse_h, coarse_w) = (shape_of(grid, tap) for tap in p.layers)
    row, column = p.cover(*np.indices((fine_h, fine_w)).reshape(2, -1))
    flat: NDArray[np.int64] = np.minimum(row, coarse_h - 1) * coarse_w + np.minimum(column, coarse_w - 1)
    return flat


def _emit_layer(graph: Graph, tap: str, grid: Grid, bank: Bank, p: FapmParameters) -> Value:
    """Compute the distances of one layer in a graph."""
    c, h, w = tile_grid(grid).taps[tap]
    tiles = math.prod(layout(grid))
    maps = emit_split(graph, graph.input(tap, ("n", *grid.taps[tap])), grid.taps[tap], grid)
    if p.pooling > 1:
        maps = graph.op(
            "AveragePool", maps, kernel_shape=[p.pooling] * 2, pads=[p.pooling // 2] * 4, count_include_pad=1
        )
    rows = graph.transpose(graph.reshape(maps, -1, c, h * w), 0, 2, 1)
    rows = graph.reshape(rows, -1, tiles * h * w, c)
    distances = emit_prototype_distances(graph, rows, tap, bank.arrays, p.looked_at)
    if p.is_calibrated:
        weight = graph.unsqueeze(graph.input(f"{tap}_weight", (tiles * h * w,)), 1)
        distances = graph.op("Mul", distances, weight)
    return distances
