"""FAPM: a few prototypes for each place, more of them where nominal presses vary more.

Definition (Kim, Park, Cho and Lee, "FAPM: Fast adaptive patch memory for real-time industrial anomaly detection",
ICASSP 2023), read against eastbrother87/FAPM_official @5d2d2f2, which scores but does not fit, and the seed paper's
scripts, which fit. Two layers are averaged over 3x3 cells; the grid is cut into cells of 4x4 fine and 2x2 coarse
sub-patches (32 px); k-centre keeps 10 % of the nominal descriptors (near) or twice as many (far); the distances to the
nearest prototypes of both layers are added.

Not public, and therefore ours: which cells get the far bank. Here: those whose near bank leaves a nominal descriptor
farthest away, the upper tenth of the cells of each layer (the seed scripts' rule).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from edge.core.errors import FitError
from plugins.detectors.choices import bank_bytes, choose, repaired, require_fittable, require_scorable
from plugins.detectors.maths.coreset import greedy_from_distances
from plugins.detectors.maths.distances import nearest
from plugins.detectors.maths.mosaic import emit_join, emit_split, join, layout, split, tile_grid
from plugins.detectors.maths.shortlist import SHORTLIST, emit_group_nearest, emit_ranked
from plugins.detectors.maths.smoothing import PAPER_SIGMA_PX, Smoothing, Upsampling, emit_scores
from plugins.graph import Graph, Value

__all__ = ["FapmParameters", "fapm"]

# Sub-patches along one side of a cell, fine and coarse: FAPM_official test.py.
FINE_SIDE, COARSE_SIDE = 4, 2
# Cells whose scale is below this quantile of all cells' are taken to have that scale, so that calibration only lowers
# the restless ones. With a low quantile, gel that most presses leave alone turned into the highest scores: on two
# simulated parts AU-PRO@0.01 was 0.15 and 0.00 at 0.05, 0.11 and 0.19 at 0.75, 0.05 and 0.13 uncalibrated.
SCALE_FLOOR_QUANTILE = 0.75
# Pairwise distances held at once during a fit (float32 numbers, 16 MB: they stay in the cache).
PAIRS = 4 * 2**20
# A squared distance below this part of the two squared lengths is rounding of the float32 product form.
ROUNDING = 2e-6
# The paper's four pixels at 320x240, where a millimetre is 15.77 pixels.
SIGMA_MM = PAPER_SIGMA_PX / 15.77


@dataclass(frozen=True)
class FapmParameters:
    """What FAPM can be told; every repair is a switch of its own.

    layers: fine and coarse tap. banks: `location` keeps prototypes for each place (the seed paper), `cell` shares them
    among the sub-patches of a cell (the official code), which tolerates a shifted press. near_fraction, far_factor:
    prototypes kept, and how many times more in far cells. far_quantile: which cells are far. neighbours: nearest
    prototypes looked at.
    fusion: `quadrants` gives each fine sub-patch the coarse one above it, `rows` is the published layout, which gives
    half of them another quadrant's. is_calibrated: distances are divided by the cell's median distance between a
    nominal press and the prototypes of others.
    weighting: what multiplies the press's largest distance: `none` takes the maximum of the score map, `largest` is the
    published weight from the farthest of the neighbours, `nearest` the one of PatchCore's paper.
    is_softmax_stable: the weight survives distances above 88. is_single_unweighted: no weight where there is but one
    neighbour, instead of the weight 0.
    sigma: the blur, in `sigma_unit`. is_sampled: a cell's distance is drawn where its convolution looks, its top left
    pixel. packing: of the prototypes; `auto` is the finest that stays within bank_mb
    megabytes (at 224x224, up to four times as many for larger frames).
    """

    mode: Mode = "corrected"
    layers: tuple[str, ...] = ("layer2", "layer3")
    banks: Literal["location", "cell"] = "cell"
    near_fraction: float = 0.10
    far_factor: float = 2.0
    far_quantile: float = 0.9
    neighbours: int = 4
    fusion: Literal["quadrants", "rows"] = "quadrants"
    is_calibrated: bool = True
    weighting: Literal["none", "largest", "nearest"] = "none"
    is_softmax_stable: bool = True
    is_single_unweighted: bool = True
    sigma: float = SIGMA_MM
    sigma_unit: Literal["mm", "px"] = "mm"
    is_sampled: bool = True
    packing: Packing | Literal["auto"] = "auto"
    bank_mb: float = 16.0

    def __post_init__(self) -> None:
        if len(self.layers) != 2 or self.layers[0] == self.layers[1]:
            raise ValueError(f"layers are a fine and a coarse tap, found {self.layers}")
        if not (0 < self.near_fraction <= 1 and self.far_factor >= 1 and 0 <= self.far_quantile <= 1):
            raise ValueError(
                "near_fraction lies in (0, 1], far_factor is at least 1 and far_quantile lies in [0, 1], "
                f"found {self.near_fraction}, {self.far_factor}, {self.far_quantile}"
            )
        if self.neighbours < 1 or not (math.isfinite(self.sigma) and self.sigma >= 0) or not self.bank_mb > 0:
            raise ValueError(
                f"neighbours is at least 1, sigma at least 0 and bank_mb positive, found {self.neighbours}, "
                f"{self.sigma}, {self.bank_mb}"
            )
        for name, known in (
            ("banks", ("location", "cell")),
            ("fusion", ("quadrants", "rows")),
            ("weighting", ("none", "largest", "nearest")),
            ("sigma_unit", ("mm", "px")),
            ("packing", ("auto", "none", "float16", "int8")),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is one of {', '.join(known)}, found '{getattr(self, name)}'")

    def smoothing(self, grid: Grid) -> Smoothing:
        sigma_px = self.sigma * (grid.pixels_per_mm if self.sigma_unit == "mm" else 1.0)
        cells = grid.taps[self.layers[0]][1:]
        kind: Upsampling = "sampled" if self.is_sampled else "bilinear"
        return Smoothing(cells, grid.frame, sigma_px, kind, grid.tiles)


PAPER = FapmParameters(
    mode="paper",
    banks="location",
    fusion="rows",
    is_calibrated=False,
    weighting="largest",
    is_softmax_stable=False,
    is_single_unweighted=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
)


class Layout(NamedTuple):
    """One layer's sub-patches. cell: int64 (h * w,), the cell of each. groups: int64 (g, s), those that share a bank;
    the last cell of an axis repeats its border where the grid ends inside it."""

    cell: NDArray[np.int64]
    groups: NDArray[np.int64]

    @property
    def back(self) -> NDArray[np.int64]:
        """Where each sub-patch stands in the flattened groups: int64 (h * w,)."""
        return np.unique(self.groups.reshape(-1), return_index=True)[1]


REPAIRS = (
    "banks",
    "fusion",
    "is_calibrated",
    "weighting",
    "is_softmax_stable",
    "is_single_unweighted",
    "is_sampled",
)
"""The switches that set the corrected mode apart; the others are operating points."""


class Fapm:
    """FAPM under the entry points `gelgate.detectors`."""

    name = "fapm"

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> FapmParameters:
        """The mode's parameters with overrides. Errors: FitError."""
        return choose(self.name, PAPER if mode == "paper" else FapmParameters(), overrides)

    def taps(self, parameters: FapmParameters) -> tuple[str, ...]:
        return parameters.layers

    def fit(
        self,
        nominal: Nominal,
        grid: Grid,
        parameters: FapmParameters,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Bank:
        """Prototypes per group of sub-patches. Arrays per layer: `<tap>_mean` (groups, c); `<tap>_near` and `<tap>_far`
        (groups of that kind, prototypes, c), centred; `<tap>_order` int64 (groups,), where a group stands among near
        then far; `<tap>_near_groups`, `<tap>_far_groups`; `<tap>_weight` (h * w,) where calibrated. Errors: FitError.
        """
        p = parameters
        require_fittable(self.name, nominal, grid, p.layers, is_tileable=True)
        _require_halved(grid, p)
        # One start for every group: a share of the set, so that it means the same at every size.
        start = float(rng.random())
        arrays: dict[str, NDArray[Any]] = {}
        facts: dict[str, Any] = {"start": start, "repairs": repaired(p, PAPER, REPAIRS), "warnings": []}
        for number, tap in enumerate(p.layers):
            layer, learnt = _fit_layer(_pooled(nominal.features[tap], grid), _layout(grid, tap, p), start, p)
            arrays |= {f"{tap}_{name}": array for name, array in layer.items()}
            facts |= {f"{tap}_{name}": value for name, value in learnt.items()}
            progress((number + 1) / len(p.layers))
        names = [f"{tap}_{kind}" for tap in p.layers for kind in ("near", "far") if f"{tap}_{kind}" in arrays]
        packing = _packing(sum(arrays[name].size for name in names), grid, p, facts["warnings"])
        if p.weighting != "none" and _fewest(arrays, p) < 2:
            facts["warnings"].append(
                "one prototype per group: there is no second neighbour to weight a score by"
            )
        return Bank(arrays, dict.fromkeys(names, packing), facts)

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: FapmParameters
    ) -> ScoreMaps:
        """The float64 oracle. Errors: NotScorable for features that are not finite."""
        p = parameters
        require_scorable(self.name, features, p.layers)
        fine, coarse = (
            _layer_distances(
                _pooled(features[tap].astype(np.float64), grid), tap, _layout(grid, tap, p), bank.arrays, p
            )
            for tap in p.layers
        )
        fused = fine + coarse[:, _coarse_of_fine(grid, p)]
        smoothing = p.smoothing(grid)
        cells = tile_grid(grid).taps[p.layers[0]][1:]
        maps = smoothing.score_maps(join(fused[:, :, 0].reshape(-1, *cells), grid))
        if p.weighting == "none":
            return maps
        top = fused[:, :, 0].argmax(axis=1)
        neighbours = fused[np.arange(len(fused)), top]
        return ScoreMaps(maps.score_map, neighbours[:, 0] * _weight(neighbours, _fewest(bank.arrays, p), p))

    def head(self, grid: Grid, bank: Bank, parameters: FapmParameters) -> bytes:
        """The graph; the number of prototypes is free."""
        p = parameters
        graph = Graph(self.name)
        fine, coarse = (_emit_layer(graph, tap, grid, bank, p) for tap in p.layers)
        fused = graph.op(
            "Add", fine, graph.op("Gather", coarse, graph.constant(_coarse_of_fine(grid, p)), axis=1)
        )
        nearest_of = _emit_first(graph, fused, 2)
        smoothing = p.smoothing(grid)
        score = None
        if p.weighting != "none":
            top = graph.op("ArgMax", nearest_of, axis=1, keepdims=1)
            neighbours = graph.op("GatherND", fused, top, batch_dims=1)
            score = _emit_weighted(graph, neighbours, _fewest(bank.arrays, p), p)
        cells = tile_grid(grid).taps[p.layers[0]][1:]
        emit_scores(
            graph, emit_join(graph, graph.reshape(nearest_of, -1, *cells), cells, grid), smoothing, score
        )
        return graph.serialise()


fapm = Fapm()


def _shape(grid: Grid, tap: str) -> tuple[int, int]:
    """Rows and columns of a tap's sub-patches, tiles one under the other."""
    _, h, w = tile_grid(grid).taps[tap]
    return math.prod(layout(grid)) * h, w


def _require_halved(grid: Grid, p: FapmParameters) -> None:
    fine, coarse = (tile_grid(grid).taps[tap][1:] for tap in p.layers)
    if tuple(-(-n // 2) for n in fine) != coarse:
        raise FitError(
            f"fapm: '{p.layers[1]}' is {coarse}, half of '{p.layers[0]}' would be {tuple(-(-n // 2) for n in fine)}; "
            "choose two layers that follow each other"
        )


def _side(tap: str, p: FapmParameters) -> int:
    """Sub-patches along one side of a cell."""
    return FINE_SIDE if tap == p.layers[0] else COARSE_SIDE


def _layout(grid: Grid, tap: str, p: FapmParameters) -> Layout:
    h, w = _shape(grid, tap)
    side = _side(tap, p)
    rows, columns = -(-h // side), -(-w // side)
    cell = (np.arange(h)[:, None] // side * columns + np.arange(w)[None] // side).ravel()
    if p.banks == "location":
        return Layout(cell, np.arange(h * w)[:, None])
    y = np.minimum(np.arange(rows * side), h - 1).reshape(rows, 1, side, 1)
    x = np.minimum(np.arange(columns * side), w - 1).reshape(1, columns, 1, side)
    return Layout(cell, (y * w + x).reshape(rows * columns, -1))


def _coarse_of_fine(grid: Grid, p: FapmParameters) -> NDArray[np.int64]:
    """Which coarse sub-patch each fine one gets: int64 (fine h * w,)."""
    (fine_h, fine_w), (coarse_h, coarse_w) = (_shape(grid, tap) for tap in p.layers)
    y, x = np.indices((fine_h, fine_w)).reshape(2, -1)
    if p.fusion == "quadrants":
        row, column = y // 2, x // 2
    else:
        # The release repeats each of a cell's four coarse values four times in a row: quadrant c falls on fine row c.
        quadrant = y % FINE_SIDE
        row = y // FINE_SIDE * COARSE_SIDE + quadrant // COARSE_SIDE
        column = x // FINE_SIDE * COARSE_SIDE + quadrant % COARSE_SIDE
    flat: NDArray[np.int64] = np.minimum(row, coarse_h - 1) * coarse_w + np.minimum(column, coarse_w - 1)
    return flat


def _pooled(layer: NDArray[np.floating], grid: Grid) -> NDArray[np.floating]:
    """Means over 3x3 cells, zeros beyond the border of a tile counted: (n, c, H, W) to rows (n, sub-patches, c)."""
    maps = split(layer, grid)
    h, w = maps.shape[2:]
    padded = np.pad(maps, ((0, 0), (0, 0), (1, 1), (1, 1)))
    down = padded[:, :, :h] + padded[:, :, 1 : h + 1] + padded[:, :, 2:]
    sums = down[..., :w] + down[..., 1 : w + 1] + down[..., 2:]
    rows: NDArray[np.floating] = np.swapaxes(sums.reshape(*maps.shape[:2], -1) / sums.dtype.type(9), 1, 2)
    return rows.reshape(len(layer), -1, rows.shape[2])


def _fit_layer(
    rows: NDArray[np.floating], places: Layout, start: float, p: FapmParameters
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """The arrays of one layer from its averaged sub-patches (n, h * w, c), and what was learnt."""
    n, _, c = rows.shape
    groups, s = places.groups.shape
    near = max(1, int(p.near_fraction * n * s))
    far = min(max(near, int(p.far_factor * near)), n * s)
    mean = np.empty((groups, c), np.float32)
    chosen = np.empty((groups, far, c), np.float32)
    radius = np.empty((groups, s))
    apart = np.empty((2, groups, s * n))
    step = max(1, PAIRS // (n * s) ** 2)
    for first in range(0, groups, step):
        part = slice(first, first + step)
        # (groups, presses * sub-patches, c), press by press.
        x = rows[:, places.groups[part]].swapaxes(0, 1).reshape(-1, n * s, c)
        mean[part] = x.mean(axis=1, dtype=np.float64)
        x = x - mean[part, None]
        lengths, squared = _pairwise(x)
        picks = greedy_from_distances(squared, far, int(start * n * s))
        chosen[part] = np.take_along_axis(x, picks[:, :, None], axis=1)
        distances = _to_picks(lengths, squared, picks)
        radius[part] = distances[:, :, :near].min(axis=2).reshape(-1, n, s).max(axis=1)
        press = np.arange(n * s) // s
        distances[press[:, None] == press[picks][:, None, :]] = np.inf
        apart[0, part], apart[1, part] = distances[:, :, :near].min(axis=2), distances.min(axis=2)
    cell_of_group = places.cell[places.groups[:, 0]]
    cells = int(places.cell.max()) + 1
    reach = np.bincount(cell_of_group, radius.mean(axis=1), cells) / np.bincount(
        cell_of_group, minlength=cells
    )
    is_far = (reach >= np.quantile(reach, p.far_quantile))[cell_of_group]
    arrays: dict[str, NDArray[Any]] = {"mean": mean}
    parts = [np.flatnonzero(~is_far), np.flatnonzero(is_far)]
    arrays["order"] = np.argsort(np.concatenate(parts))
    for kind, members, count in zip(("near", "far"), parts, (near, far), strict=True):
        if len(members):
            arrays[f"{kind}_groups"] = members
            arrays[kind] = np.ascontiguousarray(chosen[members, :count])
    if p.is_calibrated:
        own = np.where(is_far[:, None], apart[1], apart[0])
        arrays["weight"] = _cell_weights(own, cell_of_group, cells)[places.cell]
    return arrays, {"near_prototypes": near, "far_prototypes": far, "far_groups": int(is_far.sum())}


def _pairwise(x: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Squared lengths (g, n) and pairwise squared distances (g, n, n) of each group's centred rows (g, n, c)."""
    lengths = np.einsum("gnc,gnc->gn", x, x)
    squared = x @ np.ascontiguousarray(x.swapaxes(1, 2))
    squared *= -2
    squared += lengths[:, :, None]
    squared += lengths[:, None, :]
    np.maximum(squared, 0, out=squared)
    return lengths, squared


def _to_picks(
    lengths: NDArray[np.float32], squared: NDArray[np.float32], picks: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Plain distances (g, n, picks) of every row to the picked ones; what is rounding is 0."""
    chosen = np.take_along_axis(squared, picks[:, None, :], axis=2)
    both = lengths[:, :, None] + np.take_along_axis(lengths, picks, axis=1)[:, None, :]
    chosen[chosen <= ROUNDING * both] = 0.0
    return np.sqrt(chosen, dtype=np.float64)


def _cell_weights(
    apart: NDArray[np.float64], cell_of_group: NDArray[np.int64], cells: int
) -> NDArray[np.float32]:
    """One over the scale of each cell: the median of its nominal distances to other presses' prototypes.

    Scales are floored at the upper quartile of all; where no press has another to be compared with, they are all 1.
    """
    scale = np.empty(cells)
    for cell in range(cells):
        values = apart[cell_of_group == cell]
        values = values[np.isfinite(values)]
        scale[cell] = np.median(values) if values.size else np.nan
    known = scale[np.isfinite(scale) & (scale > 0)]
    if not known.size:
        return np.ones(cells, np.float32)
    scale = np.where(np.isfinite(scale), scale, np.median(known))
    return (1 / np.maximum(scale, np.quantile(known, SCALE_FLOOR_QUANTILE))).astype(np.float32)


def _packing(numbers: int, grid: Grid, p: FapmParameters, warnings: list[str]) -> Packing:
    """How the prototypes are stored."""
    if p.packing != "auto":
        return p.packing
    room = bank_bytes(p.bank_mb, grid)
    if 2 * numbers <= room:
        return "float16"
    if numbers > room:
        warnings.append(
            f"{numbers} bytes of prototypes in int8, more than the {room} that bank_mb allows; lower near_fraction"
        )
    return "int8"


def _fewest(arrays: Mapping[str, NDArray[Any]], p: FapmParameters) -> int:
    """Prototypes in the smallest group."""
    kinds = [f"{tap}_{kind}" for tap in p.layers for kind in ("near", "far")]
    return min(int(arrays[name].shape[1]) for name in kinds if name in arrays)


def _layer_distances(
    rows: NDArray[np.floating],
    tap: str,
    places: Layout,
    arrays: Mapping[str, NDArray[Any]],
    p: FapmParameters,
) -> NDArray[np.float64]:
    """Distances (n, h * w, neighbours) to each sub-patch's nearest prototypes, the last one repeated to the number."""
    distances = np.empty((*rows.shape[:2], p.neighbours))
    for kind in ("near", "far"):
        for bank, group in zip(
            arrays.get(f"{tap}_{kind}", ()), arrays.get(f"{tap}_{kind}_groups", ()), strict=True
        ):
            where = np.unique(places.groups[group])
            asked = rows[:, where] - arrays[f"{tap}_mean"][group]
            found = nearest(asked.reshape(-1, rows.shape[2]), bank, p.neighbours).distances
            repeated = found[:, np.minimum(np.arange(p.neighbours), found.shape[1] - 1)]
            distances[:, where] = repeated.reshape(len(rows), len(where), -1)
    if p.is_calibrated:
        distances *= arrays[f"{tap}_weight"].astype(np.float64)[:, None]
    return distances


def _weight(neighbours: NDArray[np.float64], fewest: int, p: FapmParameters) -> NDArray[np.float64]:
    """The factor (n,) of a press's largest distance from its neighbours' distances (n, k)."""
    if min(p.neighbours, fewest) < 2 and p.is_single_unweighted:
        return np.ones(len(neighbours))
    shifted = neighbours - neighbours.max(axis=1, keepdims=True) if p.is_softmax_stable else neighbours
    with np.errstate(over="ignore", invalid="ignore"):
        share = np.exp(shifted)
        share /= share.sum(axis=1, keepdims=True)
    weight: NDArray[np.float64] = 1 - (share.max(axis=1) if p.weighting == "largest" else share[:, 0])
    return weight


def _emit_layer(graph: Graph, tap: str, grid: Grid, bank: Bank, p: FapmParameters) -> Value:
    """Distances (n, h * w, neighbours) of one layer."""
    places = _layout(grid, tap, p)
    c, h, w = tile_grid(grid).taps[tap]
    tiles = math.prod(layout(grid))
    groups, s = places.groups.shape
    maps = emit_split(graph, graph.input(tap, ("n", *grid.taps[tap])), grid.taps[tap], grid)
    pooled = graph.op("AveragePool", maps, kernel_shape=[3, 3], pads=[1, 1, 1, 1], count_include_pad=1)
    rows = graph.transpose(graph.reshape(pooled, -1, tiles, c, h * w), 1, 3, 0, 2)
    rows = graph.reshape(rows, tiles * h * w, -1, c)
    rows = graph.op("Gather", rows, graph.constant(places.groups), axis=0)
    rows = graph.reshape(rows, groups, -1, c)
    asked = graph.op(
        "Sub", rows, graph.op("Unsqueeze", graph.input(f"{tap}_mean", (groups, c)), graph.ints(1))
    )
    parts = []
    for kind in ("near", "far"):
        if f"{tap}_{kind}" in bank.arrays:
            members = graph.input(f"{tap}_{kind}_groups", (f"{tap}_{kind}_groups",), "int64")
            prototypes = graph.input(f"{tap}_{kind}", (f"{tap}_{kind}_groups", f"{tap}_{kind}_prototypes", c))
            here = graph.op("Gather", asked, members, axis=0)
            found = emit_group_nearest(
                graph, here, emit_ranked(graph, prototypes), c, p.neighbours, max(p.neighbours, SHORTLIST)
            )
            parts.append(_emit_repeated(graph, found, p.neighbours))
    distances = graph.op("Concat", *parts, axis=0) if len(parts) > 1 else parts[0]
    distances = graph.op("Gather", distances, graph.input(f"{tap}_order", (groups,), "int64"), axis=0)
    distances = graph.transpose(graph.reshape(distances, groups, s, -1, p.neighbours), 2, 0, 1, 3)
    distances = graph.reshape(distances, 0, groups * s, p.neighbours)
    distances = graph.op("Gather", distances, graph.constant(places.back), axis=1)
    if p.is_calibrated:
        weight = graph.op("Unsqueeze", graph.input(f"{tap}_weight", (tiles * h * w,)), graph.ints(1))
        distances = graph.op("Mul", distances, weight)
    return distances


def _emit_repeated(graph: Graph, distances: Value, neighbours: int) -> Value:
    """Distances (g, q, found) brought to (g, q, neighbours) by repeating the last."""
    last = graph.op("Sub", graph.op("Shape", distances, start=2, end=3), graph.ints(1))
    return graph.op("Gather", distances, graph.op("Min", graph.ints(*range(neighbours)), last), axis=2)


def _emit_first(graph: Graph, value: Value, axis: int) -> Value:
    """The first slice along an axis, the axis gone."""
    return graph.op("Squeeze", graph.op("Gather", value, graph.ints(0), axis=axis), graph.ints(axis))


def _emit_weighted(graph: Graph, neighbours: Value, fewest: int, p: FapmParameters) -> Value:
    """The press's score (n,) from the distances (n, k) at its most anomalous sub-patch."""
    top = _emit_first(graph, neighbours, 1)
    if min(p.neighbours, fewest) < 2 and p.is_single_unweighted:
        return top
    shifted = neighbours
    if p.is_softmax_stable:
        shifted = graph.op("Sub", neighbours, graph.op("ReduceMax", neighbours, graph.ints(1), keepdims=1))
    grown = graph.op("Exp", shifted)
    share = graph.op("Div", grown, graph.op("ReduceSum", grown, graph.ints(1), keepdims=1))
    if p.weighting == "largest":
        part = graph.op("ReduceMax", share, graph.ints(1), keepdims=0)
    else:
        part = _emit_first(graph, share, 1)
    return graph.op("Mul", top, graph.op("Sub", graph.scalar(1.0), part))
