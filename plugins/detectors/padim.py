"""PaDiM: one Gaussian per location, its covariance never formed but as thin eigenpairs.

Idea: at each cell of the feature grid the nominal descriptors have a mean and a covariance; a press scores by its
Mahalanobis distance there. With N presses and N <= d channels the covariance has at most N-1 directions, and

    distance^2 = sum_j t_j^2 / (lambda_j + ridge) + |delta - U^T t|^2 / ridge,    t = U delta

is exact with rank N-1 (Woodbury) and an operating point with a smaller rank: directions beyond it count as ridge, the
term off the span stays exact. Cells that no nominal press touches share one such Gaussian, around their own means.

Ref: T. Defard et al., PaDiM (2020); the published implementation keeps 550 of 1792 channels and adds 0.01 to the
covariance's diagonal. Measured by us in float64: fit by the Gram matrix and explicit residual, error below 1e-6.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from edge.core.errors import FitError
from plugins.detectors.choices import bank_bytes, choose, repaired, require_fittable, require_scorable
from plugins.detectors.maths.embedding import (
    Embedded,
    Embedding,
    EmbeddingChoice,
    Projection,
    blocks,
    learn_embedding,
    touched_cells,
)
from plugins.detectors.maths.lowrank import Spectrum, covariance_spectrum, mahalanobis_squared, spectrum
from plugins.detectors.maths.mosaic import stepped
from plugins.detectors.maths.smoothing import PAPER_SIGMA_PX, Smoothing, emit_scores
from plugins.graph import Graph, Value

__all__ = ["PadimParameters", "padim"]

# The seed paper's scripts add 0.01 at fit and 0.01 again at prediction; the published implementation adds it once.
PAPER_RIDGE = 0.01
# The seed paper: 550 of the 1792 channels of Wide-ResNet-50-2.
PAPER_CHANNELS = 550
# The paper's four pixels at 320x240, where a millimetre is 15.77 pixels.
SIGMA_MM = PAPER_SIGMA_PX / 15.77


@dataclass(frozen=True)
class PadimParameters:
    """Every choice of PaDiM; the defaults are the corrected mode's default operating point.

    Measured on three simulated parts with random ResNet-18 weights, mean AU-PRO up to 1 % false positives: the paper's
    mode 0.15; all three taps 0.19; layer1 and layer2 0.34; those with neighbours 0.42 on layer1's grid and 0.38 on
    layer2's, at equal image AUROC 0.86; with layer1 alone 0.56, which trained weights may not need. Neighbours gain
    most where parts are placed by hand. layer2's grid is the default because its fit takes a quarter of the time.

    ridge: added to the covariance's diagonal; in units of the mean nominal variance where the taps are balanced.
    is_ridge_twice: add it again at prediction, as the seed paper's scripts do. rank: directions kept per location
    (None: all, exact). neighbours: 0, or 1 to fit each location on its 3x3 neighbourhood (tolerates small shifts).
    sigma: the blur, in `sigma_unit`. is_touched_only: cells that no press touches (within margin_mm) share one
    Gaussian. is_sampled: see EmbeddingChoice. packing: of the eigenvectors. bank_mb: a stated rank is lowered until
    the bank has at most this many megabytes as stored at 224x224, up to four times as many for larger frames.
    """

    mode: Mode = "corrected"
    taps: tuple[str, ...] = ("layer1", "layer2")
    grid_tap: str = "layer2"
    projection: Projection = "semi_orthogonal"
    channels: int | None = 96
    is_balanced: bool = True
    is_sampled: bool = True
    ridge: float = 0.1
    is_ridge_twice: bool = False
    rank: int | None = 32
    neighbours: int = 1
    is_touched_only: bool = True
    margin_mm: float = 1.0
    sigma: float = SIGMA_MM
    sigma_unit: Literal["mm", "px"] = "mm"
    packing: Packing = "int8"
    bank_mb: float | None = 16.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.ridge) and self.ridge > 0):
            raise ValueError(f"ridge is a positive number, found {self.ridge}")
        if self.rank is not None and self.rank < 1:
            raise ValueError(f"rank is at least 1, or None for exact, found {self.rank}")
        if self.neighbours not in (0, 1):
            raise ValueError(f"neighbours is 0 or 1 (a 3x3 neighbourhood), found {self.neighbours}")
        if not self.sigma >= 0 or not self.margin_mm >= 0:
            raise ValueError(f"sigma and margin_mm are at least 0, found {self.sigma} and {self.margin_mm}")
        if self.bank_mb is not None and not self.bank_mb > 0:
            raise ValueError(f"bank_mb is a positive number, or None for no limit, found {self.bank_mb}")
        if self.sigma_unit not in ("mm", "px") or self.packing not in ("none", "float16", "int8"):
            raise ValueError(
                f"sigma_unit is mm or px and packing none, float16 or int8, found {self.sigma_unit}, {self.packing}"
            )
        _ = self.embedding

    @property
    def embedding(self) -> EmbeddingChoice:
        return EmbeddingChoice(
            self.taps, self.grid_tap, self.projection, self.channels, self.is_balanced, self.is_sampled
        )

    @property
    def total_ridge(self) -> float:
        return self.ridge * (2 if self.is_ridge_twice else 1)

    def smoothing(self, grid: Grid, cells: tuple[int, int]) -> Smoothing:
        sigma_px = self.sigma * (grid.pixels_per_mm if self.sigma_unit == "mm" else 1.0)
        return Smoothing(
            cells, grid.frame, sigma_px, "sampled" if self.is_sampled else "bilinear", grid.tiles
        )


PAPER = PadimParameters(
    mode="paper",
    taps=("layer1", "layer2", "layer3"),
    grid_tap="layer1",
    neighbours=0,
    projection="random",
    channels=PAPER_CHANNELS,
    is_balanced=False,
    is_sampled=False,
    ridge=PAPER_RIDGE,
    is_ridge_twice=True,
    rank=None,
    is_touched_only=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    packing="none",
    bank_mb=None,
)

REPAIRS = (
    "projection",
    "is_balanced",
    "is_sampled",
    "is_ridge_twice",
    "neighbours",
    "is_touched_only",
    "sigma_unit",
)
"""What `corrected` does otherwise than the publication, apart from the operating point (taps, channels, rank)."""


class Padim:
    """The detector. A press's score is the maximum of its smoothed map."""

    name = "padim"

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> PadimParameters:
        """See PadimParameters. Errors: FitError."""
        return choose(self.name, PAPER if mode == "paper" else PadimParameters(), overrides)

    def taps(self, parameters: PadimParameters) -> tuple[str, ...]:
        return parameters.taps

    def fit(
        self,
        nominal: Nominal,
        grid: Grid,
        parameters: PadimParameters,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Bank:
        """Means and eigenpairs per touched cell, one shared set elsewhere. Errors: FitError."""
        require_fittable(self.name, nominal, grid, parameters.taps, is_tileable=True)
        cells = grid.taps[parameters.grid_tap][1:]
        touched = np.ones(cells[0] * cells[1], bool)
        if parameters.is_touched_only:
            touched = touched_cells(nominal, grid, cells, parameters.margin_mm)
        if not touched.any():
            raise FitError(
                "padim: no nominal press touches the inspected region; move the region or press the part"
            )
        embedding = learn_embedding(parameters.embedding, grid, nominal, touched, rng)
        locations, elsewhere = np.flatnonzero(touched), np.flatnonzero(~touched)
        descriptors = embedding.numpy(nominal.features, np.float32)
        affordable = _affordable(embedding, len(locations), grid, parameters)
        local = _fit_local(descriptors, locations, replace(parameters, rank=affordable), progress)
        shared = _fit_shared(embedding, descriptors, nominal, elsewhere, parameters)
        mean = np.empty((embedding.count, embedding.width), np.float32)
        mean[locations], mean[elsewhere] = local.pop("mean"), shared.pop("mean")
        arrays = {**embedding.arrays, "mean": mean, **local}
        if len(elsewhere):
            arrays |= {"locations": locations, "elsewhere": elsewhere, **shared}
            arrays["order"] = np.argsort(np.concatenate([locations, elsewhere]))
        return Bank(arrays, _packing(arrays, parameters), _facts(nominal, embedding, arrays, parameters))

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: PadimParameters
    ) -> ScoreMaps:
        """The oracle. Errors: NotScorable for features that are not finite."""
        require_scorable(self.name, features, parameters.taps)
        arrays = bank.arrays
        embedding = _embedding(grid, bank, parameters)
        descriptors = embedding.numpy(features)
        squared = np.empty((embedding.count, next(iter(features.values())).shape[0]))
        every = np.arange(embedding.count)
        locations, elsewhere = arrays.get("locations", every), arrays.get("elsewhere", every[:0])
        ridge = parameters.total_ridge
        for part in blocks(len(locations)):
            delta = descriptors.at(locations[part]) - arrays["mean"][locations[part], None].astype(np.float64)
            values = 1 / arrays["weights"][part].astype(np.float64) - ridge
            squared[locations[part]] = mahalanobis_squared(
                delta, values, arrays["basis"][part].astype(np.float64), ridge
            )
        for part in blocks(len(elsewhere)):
            delta = descriptors.at(elsewhere[part]) - arrays["mean"][elsewhere[part], None].astype(np.float64)
            values = 1 / arrays["shared_weights"].astype(np.float64) - ridge
            squared[elsewhere[part]] = mahalanobis_squared(
                delta, values, arrays["shared_basis"].astype(np.float64), ridge
            )
        raw = np.sqrt(squared).T.reshape(-1, *embedding.cells)
        return parameters.smoothing(grid, embedding.cells).score_maps(raw)

    def head(self, grid: Grid, bank: Bank, parameters: PadimParameters) -> bytes:
        """Taps and bank in; score_map, score and raw_map out. How many directions there are is free."""
        arrays, embedding = bank.arrays, _embedding(grid, bank, parameters)
        graph = Graph("padim")
        count, width = embedding.count, embedding.width
        delta = graph.op("Sub", embedding.emit(graph), graph.input("mean", (count, width)))
        basis, weights = (
            graph.input("basis", ("locations", "rank", width)),
            graph.input("weights", ("locations", "rank")),
        )
        if "locations" not in arrays:
            squared = _squared(graph, delta, basis, weights, parameters.total_ridge)
        else:
            shared = (
                graph.input("shared_basis", ("directions", width)),
                graph.input("shared_weights", ("directions",)),
            )
            here = graph.op("Gather", delta, graph.input("locations", ("locations",), "int64"), axis=1)
            there = graph.op("Gather", delta, graph.input("elsewhere", ("elsewhere",), "int64"), axis=1)
            local = _squared(graph, here, basis, weights, parameters.total_ridge)
            rest = _squared_shared(graph, there, *shared, parameters.total_ridge)
            both = graph.op("Concat", local, rest, axis=1)
            squared = graph.op("Gather", both, graph.input("order", (count,), "int64"), axis=1)
        raw = graph.reshape(graph.op("Sqrt", squared), -1, *embedding.cells)
        emit_scores(graph, raw, parameters.smoothing(grid, embedding.cells))
        return graph.serialise()


padim = Padim()


def _affordable(embedding: Embedding, locations: int, grid: Grid, parameters: PadimParameters) -> int | None:
    """The rank asked for, or the largest with which the bank stays within its megabytes; at least 1."""
    if parameters.rank is None or parameters.bank_mb is None:
        return parameters.rank
    itemsize = {"none": 4, "float16": 2, "int8": 1}[parameters.packing]
    # Besides a direction's components: its weight, and with int8 its scale, float32 each.
    direction = locations * (embedding.width * itemsize + 4 + 4 * (parameters.packing == "int8"))
    means = embedding.count * embedding.width * (4 if parameters.packing == "none" else 2)
    left = bank_bytes(parameters.bank_mb, grid) - means
    return max(1, min(parameters.rank, left // direction))


def _fit_local(
    descriptors: Embedded, locations: NDArray[np.int64], parameters: PadimParameters, progress: Progress
) -> dict[str, NDArray[np.float32]]:
    """mean (m, d), basis (m, r, d), weights (m, r) = 1 / (lambda + ridge), r >= 1."""
    mean, weights, basis = [], [], []
    for part in blocks(len(locations)):
        here = locations[part]
        if parameters.neighbours:
            found = _of_neighbours(descriptors, here, parameters.rank)
        else:
            found = spectrum(descriptors.at(here), parameters.rank)
        rank = max(found.values.shape[1], 1)  # a single press has no direction: one of zeros stands in
        values = np.zeros((len(here), rank))
        rows = np.zeros((len(here), rank, found.mean.shape[1]))
        values[:, : found.values.shape[1]], rows[:, : found.values.shape[1]] = found.values, found.basis
        mean.append(found.mean.astype(np.float32))
        weights.append((1 / (values + parameters.total_ridge)).astype(np.float32))
        basis.append(rows.astype(np.float32))
        progress(part.stop / len(locations))
    return {"mean": np.concatenate(mean), "basis": np.concatenate(basis), "weights": np.concatenate(weights)}


def _of_neighbours(descriptors: Embedded, cells: NDArray[np.int64], rank: int | None) -> Spectrum:
    """Mean and eigenpairs of each cell's 3x3 neighbourhood, 9n samples, from the moments of the nine cells.

    At a border, of a tile too, the cell there stands for the one beyond.
    """
    (rows, columns), tiles = descriptors.embedding.cells, descriptors.embedding.grid.tiles
    down, right = (1, 1) if tiles is None else (len(tiles.rows), len(tiles.columns))
    near_rows = [stepped(cells // columns, step, rows // down) for step in (-1, 0, 1)]
    near_columns = [stepped(cells % columns, step, columns // right) for step in (-1, 0, 1)]
    nine = np.stack([row * columns + column for row in near_rows for column in near_columns], axis=1)
    needed, place = np.unique(nine, return_inverse=True)
    place = place.reshape(nine.shape)
    x = descriptors.at(needed)
    samples, width = 9 * x.shape[1], x.shape[2]
    means = x.mean(axis=1)
    x -= means[:, None]
    scatters = np.swapaxes(x, 1, 2) @ x
    mean = means[place].mean(axis=1)
    between = means[place] - mean[:, None]
    scatter = x.shape[1] * (np.swapaxes(between, 1, 2) @ between)
    for column in place.T:
        scatter += scatters[column]
    most = min(samples - 1, width)
    return covariance_spectrum(mean, scatter / (samples - 1), most if rank is None else min(rank, most))


def _fit_shared(
    embedding: Embedding,
    pressed: Embedded,
    nominal: Nominal,
    cells: NDArray[np.int64],
    parameters: PadimParameters,
) -> dict[str, NDArray[np.float32]]:
    """One covariance for all cells that no press touches, around each cell's own mean.

    What is seen there, in the presses and in the frames without contact alike, is the untouched gel.
    mean (cells, d), shared_basis (r, d), shared_weights (r,).
    """
    sources = [pressed]
    if nominal.no_contact is not None and len(cells):
        sources.append(embedding.numpy(nominal.no_contact, np.float32))
    width = embedding.width
    mean, products, freedom = np.empty((len(cells), width), np.float32), np.zeros((width, width)), 0
    for part in blocks(len(cells)):
        x = np.concatenate([source.at(cells[part]) for source in sources], axis=1)
        mean[part] = x.mean(axis=1)
        x -= x.mean(axis=1, keepdims=True)
        products += np.tensordot(x, x, axes=((0, 1), (0, 1)))
        freedom += len(x) * (x.shape[1] - 1)
    rank = min(parameters.rank or SHARED_RANK, width)
    values, vectors = np.linalg.eigh(products / max(freedom, 1))
    values, vectors = np.maximum(values[::-1][:rank], 0), vectors[:, ::-1][:, :rank]
    return {
        "mean": mean,
        "shared_basis": np.ascontiguousarray(vectors.T, np.float32),
        "shared_weights": (1 / (values + parameters.total_ridge)).astype(np.float32),
    }


# Directions of the shared Gaussian where the local ones are exact.
SHARED_RANK = 32


def _squared(graph: Graph, delta: Value, basis: Value, weights: Value, ridge: float) -> Value:
    """Squared distances (n, m) of delta (n, m, d), each location under its own basis (m, r, d) and weights (m, r).

    One row times one matrix per press and location, whatever n is: so a press scores the same alone and in a batch.
    """
    rows = graph.op("Unsqueeze", delta, graph.ints(2))
    along = graph.op("MatMul", rows, graph.transpose(basis, 0, 2, 1))
    off = graph.op("Sub", rows, graph.op("MatMul", along, basis))
    return _sum(graph, along, graph.op("Unsqueeze", weights, graph.ints(1)), off, ridge, 2, 3)


def _squared_shared(graph: Graph, delta: Value, basis: Value, weights: Value, ridge: float) -> Value:
    """The same under one basis (r, d) and weights (r,) for all locations."""
    along = graph.op("MatMul", delta, graph.transpose(basis, 1, 0))
    off = graph.op("Sub", delta, graph.op("MatMul", along, basis))
    return _sum(graph, along, weights, off, ridge, 2)


def _sum(graph: Graph, along: Value, weights: Value, off: Value, ridge: float, *axes: int) -> Value:
    """Weighted squares on the span plus squares off it by the ridge: never negative, and not finite stays so."""
    weighted = graph.op("Mul", graph.op("Mul", along, along), weights)
    inside = graph.op("ReduceSum", weighted, graph.ints(*axes), keepdims=0)
    outside = graph.op("ReduceSumSquare", off, graph.ints(*axes), keepdims=0)
    return graph.op("Add", inside, graph.op("Mul", outside, graph.scalar(1 / ridge)))


def _embedding(grid: Grid, bank: Bank, parameters: PadimParameters) -> Embedding:
    return Embedding(parameters.embedding, grid, bank.arrays)


def _packing(arrays: Mapping[str, NDArray[Any]], parameters: PadimParameters) -> dict[str, Packing]:
    """The eigenvectors as asked; means and projections never coarser than float16 (their errors do not average out)."""
    if parameters.packing == "none":
        return {}
    fine: dict[str, Packing] = {
        name: "float16" for name in arrays if name == "mean" or name.startswith("projection_")
    }
    return {**fine, "basis": parameters.packing}


def _facts(
    nominal: Nominal, embedding: Embedding, arrays: Mapping[str, NDArray[Any]], parameters: PadimParameters
) -> dict[str, Any]:
    warnings = []
    if nominal.presses == 1:
        warnings.append("a single nominal press has no covariance: every deviation counts alike")
    affordable = _affordable(embedding, len(arrays["basis"]), embedding.grid, parameters)
    if affordable is not None and arrays["basis"].shape[1] == affordable < (parameters.rank or 0):
        warnings.append(
            f"{affordable} directions per place instead of {parameters.rank} keep the bank within "
            f"{bank_bytes(parameters.bank_mb or 0, embedding.grid) / 1e6:.0f} MB"
        )
    return {
        "presses": nominal.presses,
        "channels": embedding.width,
        "rank": int(arrays["basis"].shape[1]),
        "ridge": parameters.total_ridge,
        "grid": list(embedding.cells),
        "locations": len(arrays["basis"]),
        "locations_shared": embedding.count - len(arrays["basis"]),
        "repairs": repaired(parameters, PAPER, REPAIRS),
        "warnings": warnings,
    }
