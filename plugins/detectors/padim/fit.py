"""PaDiM: one Gaussian per location, its covariance held as thin eigenpairs only.

Idea: at each cell of the feature grid the nominal descriptors have a mean and a covariance; a press scores by its
Mahalanobis distance there. With N presses and N <= d channels the covariance has at most N-1 directions, and

    distance^2 = sum_j t_j^2 / (lambda_j + ridge) + |delta - U^T t|^2 / ridge,    t = U delta

is exact with rank N-1 (Woodbury). A smaller rank is an operating point: directions beyond it count as ridge, and the
off-span term stays exact. Every cell has its own mean; the cells of a small block may share a covariance. Cells that no
nominal press touches share one such Gaussian, around their own means.

Ref: T. Defard et al., PaDiM (2020); the published implementation keeps 550 of 1792 channels and adds 0.01 to the
covariance's diagonal. Measured here in float64: fit by the Gram matrix and explicit residual, error below 1e-6.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32
from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from plugins.detectors.common.embedding import (
    Embedded,
    Embedding,
    blocks,
    learn_embedding,
    require_touched,
    touched_cells,
)
from plugins.detectors.common.lowrank import Spectrum, covariance_spectrum, mahalanobis_squared, spectrum
from plugins.detectors.common.parameters import Rng, choose, list_repairs
from plugins.detectors.common.smoothing import emit_scores
from plugins.detectors.common.tile_layout import cell_blocks, layout, neighbourhood
from plugins.detectors.common.validation import bank_bytes, require_fittable, require_scorable
from plugins.detectors.padim.paper import PAPER, REPAIRS
from plugins.detectors.padim.parameters import PadimParameters
from plugins.onnx_builder import Graph, Value

__all__ = ["PadimParameters", "emit_squared", "padim"]


class Padim:
    """The detector. A press's score is the maximum of its smoothed map."""

    name = "padim"
    compares_places = True
    is_baseline = False
    keeps_mean = True

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> PadimParameters:
        return choose(self.name, PAPER if mode == "paper" else PadimParameters(), PAPER, overrides)

    def taps(self, parameters: PadimParameters) -> tuple[str, ...]:
        return parameters.taps

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: PadimParameters, rng: Rng, progress: Progress
    ) -> Bank:
        """Means per cell, eigenpairs per touched block of cells, one shared set elsewhere. Errors: FitError."""
        p = parameters
        require_fittable(self.name, nominal, grid, p.taps)
        cells = grid.taps[p.grid_tap][1:]
        touched = np.ones(cells[0] * cells[1], bool)
        if p.is_touched_only:
            touched = require_touched(touched_cells(nominal, grid, cells, p.margin_mm))
        embedding = learn_embedding(p, grid, nominal, touched, rng)
        squares = cell_blocks(cells, layout(grid), p.block)
        squares = squares[touched[squares].any(axis=1)]
        locations = squares.ravel()
        elsewhere = np.setdiff1d(np.arange(embedding.count), locations)
        descriptors = embedding.numpy(nominal.features, np.float32)
        affordable = _affordable(embedding, len(squares), grid, p)
        local = _fit_local(descriptors, squares, p.model_copy(update={"rank": affordable}), progress)
        shared = _fit_shared(embedding, descriptors, nominal, elsewhere, p)
        mean = np.empty((embedding.count, embedding.width), np.float32)
        mean[locations], mean[elsewhere] = local.pop("mean"), shared.pop("mean")
        arrays = {**embedding.arrays, "mean": mean, **local}
        if len(elsewhere):
            arrays |= {"elsewhere": elsewhere, **shared}
        if len(elsewhere) or p.block > 1:
            # Where blocks do not fill a grid, cells at its edge are twice in `locations`; both copies are equal.
            everywhere = np.concatenate([locations, elsewhere])
            arrays |= {"locations": locations, "order": np.unique(everywhere, return_index=True)[1]}
        packing = _packing(arrays, p, _loses_in_halves(embedding, descriptors, nominal))
        return Bank(arrays, packing, _facts(nominal, embedding, arrays, p))

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: PadimParameters
    ) -> ScoreMaps:
        p = parameters
        require_scorable(self.name, features, p.taps)
        arrays = bank.arrays
        embedding = Embedding(p, grid, bank.arrays)
        descriptors = embedding.numpy(features)
        squared = np.empty((embedding.count, next(iter(features.values())).shape[0]))
        every = np.arange(embedding.count)
        locations, elsewhere = arrays.get("locations", every), arrays.get("elsewhere", every[:0])
        locations = locations.reshape(len(arrays["basis"]), -1)
        ridge = p.total_ridge
        for part in blocks(len(locations)):
            here = locations[part].ravel()
            delta = descriptors.at(here) - arrays["mean"][here, None].astype(np.float64)
            values = 1 / arrays["weights"][part].astype(np.float64) - ridge
            block = mahalanobis_squared(
                delta.reshape(len(values), -1, delta.shape[2]),
                values,
                arrays["basis"][part].astype(np.float64),
                ridge,
            )
            squared[here] = block.reshape(len(here), -1)
        for part in blocks(len(elsewhere)):
            delta = descriptors.at(elsewhere[part]) - arrays["mean"][elsewhere[part], None].astype(np.float64)
            values = 1 / arrays["shared_weights"].astype(np.float64) - ridge
            squared[elsewhere[part]] = mahalanobis_squared(
                delta, values, arrays["shared_basis"].astype(np.float64), ridge
            )
        raw = np.sqrt(squared).T.reshape(-1, *embedding.cells)
        return p.smoothing(grid, embedding.cells).score_maps(raw)

    def head(self, grid: Grid, bank: Bank, parameters: PadimParameters) -> bytes:
        """Taps and bank in; score_map, score and raw_map out. The number of directions is free."""
        arrays, embedding = bank.arrays, Embedding(parameters, grid, bank.arrays)
        graph = Graph(self.name)
        count, width = embedding.count, embedding.width
        delta = graph.op("Sub", embedding.emit(graph), graph.input("mean", (count, width)))
        basis, weights = (
            graph.input("basis", ("blocks", "rank", width)),
            graph.input("weights", ("blocks", "rank")),
        )
        here = delta
        if "locations" in arrays:
            here = graph.op("Gather", delta, graph.input("locations", ("located",), "int64"), axis=1)
        squared = emit_squared(graph, here, basis, weights, parameters.block**2, parameters.total_ridge)
        if "elsewhere" in arrays:
            shared = (
                graph.input("shared_basis", ("directions", width)),
                graph.input("shared_weights", ("directions",)),
            )
            there = graph.op("Gather", delta, graph.input("elsewhere", ("elsewhere",), "int64"), axis=1)
            rest = _squared_shared(graph, there, *shared, parameters.total_ridge)
            squared = graph.op("Concat", squared, rest, axis=1)
        if "order" in arrays:
            squared = graph.op("Gather", squared, graph.input("order", (count,), "int64"), axis=1)
        raw = graph.reshape(graph.op("Sqrt", squared), -1, *embedding.cells)
        emit_scores(graph, raw, parameters.smoothing(grid, embedding.cells))
        return graph.serialise()


padim = Padim()


def _affordable(embedding: Embedding, covariances: int, grid: Grid, p: PadimParameters) -> int | None:
    """The requested rank, or the largest with which the bank stays within `bank_mb`; at least 1."""
    if p.rank is None or p.bank_mb is None:
        return p.rank
    itemsize = {"none": 4, "float16": 2, "int8": 1}[p.packing]
    # In addition to a direction's components: its weight, and with int8 its scale, float32 each.
    direction = covariances * (embedding.width * itemsize + 4 + 4 * (p.packing == "int8"))
    means = embedding.count * embedding.width * (4 if p.packing == "none" else 2)
    left = bank_bytes(p.bank_mb, grid) - means
    return max(1, min(p.rank, left // direction))


def _fit_local(
    descriptors: Embedded, cells: NDArray[np.int64], p: PadimParameters, progress: Progress
) -> dict[str, F32]:
    """Fit blocks of cells (m, k): mean (m * k, d), basis (m, r, d), weights (m, r) = 1 / (lambda + ridge), r >= 1."""
    mean, weights, basis = [], [], []
    for part in blocks(len(cells)):
        here = cells[part]
        if p.neighbours or p.block > 1:
            fitted = _of_blocks(descriptors, here, p)
        else:
            fitted = spectrum(descriptors.at(here[:, 0]), p.rank)
        rank = max(fitted.values.shape[1], 1)  # a single press has no direction: one of zeros is used
        values = np.zeros((len(here), rank))
        rows = np.zeros((len(here), rank, fitted.mean.shape[-1]))
        values[:, : fitted.values.shape[1]], rows[:, : fitted.values.shape[1]] = fitted.values, fitted.basis
        mean.append(fitted.mean.reshape(here.size, -1).astype(np.float32))
        weights.append((1 / (values + p.total_ridge)).astype(np.float32))
        basis.append(rows.astype(np.float32))
        progress(part.stop / len(cells))
    return {"mean": np.concatenate(mean), "basis": np.concatenate(basis), "weights": np.concatenate(weights)}


def _of_blocks(descriptors: Embedded, cells: NDArray[np.int64], p: PadimParameters) -> Spectrum:
    """The means (m, k, d) of each cell of blocks (m, k), and the eigenpairs of each block's covariance.

    A cell's samples are those of its neighbourhood, 9n with neighbours; a block's covariance is the mean of its
    cells', made from the moments of single cells. Cells at a border, also of a tile, are repeated beyond it.
    """
    embedding = descriptors.embedding
    near = neighbourhood(cells.ravel(), embedding.cells, layout(embedding.grid), p.neighbours)
    needed, place = np.unique(near, return_inverse=True)
    place = place.reshape(*cells.shape, -1)
    x = descriptors.at(needed)
    presses, width = x.shape[1:]
    means = x.mean(axis=1)
    x -= means[:, None]
    scatters = np.swapaxes(x, 1, 2) @ x
    mean = means[place].mean(axis=2)
    between = (means[place] - mean[:, :, None]).reshape(len(cells), -1, width)
    scatter = presses * (np.swapaxes(between, 1, 2) @ between)
    for total, of_block in zip(scatter, place.reshape(len(cells), -1), strict=True):
        distinct, times = np.unique(of_block, return_counts=True)  # 16 of 36, in the 3x3 around 2x2 cells
        total += np.tensordot(times.astype(np.float64), scatters[distinct], 1)
    freedom = cells.shape[1] * (place.shape[2] * presses - 1)
    most = max(1, min(freedom, width))
    rank = most if p.rank is None else min(p.rank, most)
    return covariance_spectrum(mean, scatter / max(freedom, 1), rank)


def _fit_shared(
    embedding: Embedding, pressed: Embedded, nominal: Nominal, cells: NDArray[np.int64], p: PadimParameters
) -> dict[str, F32]:
    """Fit one covariance for all cells that no press touches, around each cell's own mean.

    Presses and frames without contact show the untouched gel there.
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
    rank = min(p.rank or SHARED_RANK, width)
    values, vectors = np.linalg.eigh(products / max(freedom, 1))
    values, vectors = np.maximum(values[::-1][:rank], 0), vectors[:, ::-1][:, :rank]
    return {
        "mean": mean,
        "shared_basis": np.ascontiguousarray(vectors.T, np.float32),
        "shared_weights": (1 / (values + p.total_ridge)).astype(np.float32),
    }


# Directions of the shared Gaussian where the local ones are exact.
SHARED_RANK = 32


# Float16 must not change a press by more than this part of the difference between nominal presses. The shipped trunk
# stays below 0.003; features of 1e4 that vary by 0.3 change by 13 times that, and copies of one press do not vary.
MOST_MOVED = 0.05
# Cells on which it is measured.
MEASURED_CELLS = 512


def _loses_in_halves(embedding: Embedding, descriptors: Embedded, nominal: Nominal) -> bool:
    """Tell whether means and projections stored as float16 would change a press too much.

    The error of half precision is relative to the means, and the scored deviations may be much smaller than these.
    """
    cells = np.unique(np.linspace(0, embedding.count - 1, MEASURED_CELLS).astype(np.int64))
    x = descriptors.at(cells)
    mean = x.mean(axis=1)
    deviation = float(np.sqrt(np.square(x - mean[:, None]).sum(axis=2).mean()))
    halved = {
        name: _half(array) if name.startswith("projection_") else array
        for name, array in embedding.arrays.items()
    }
    usual = {tap: nominal.features[tap].mean(axis=0, keepdims=True) for tap in embedding.choice.taps}
    seen = Embedding(embedding.choice, embedding.grid, halved).numpy(usual).at(cells)[:, 0]
    moved = float(np.linalg.norm(seen - _half(mean), axis=1).max())
    return moved > MOST_MOVED * deviation


def _half(array: NDArray[np.floating]) -> NDArray[np.floating]:
    """The array after storage as float16, which divides by a power of two."""
    top = float(np.abs(array).max(initial=0.0)) or 1.0
    with np.errstate(under="ignore"):
        stored: NDArray[np.floating] = (array / top).astype(np.float16).astype(
            array.dtype
        ) * array.dtype.type(top)
    return stored


def _packing(
    arrays: Mapping[str, NDArray[Any]], p: PadimParameters, loses_in_halves: bool
) -> dict[str, Packing]:
    """The eigenvectors as requested; means and projections as float16 at least (their errors do not average out)."""
    if p.packing == "none":
        return {}
    fine: dict[str, Packing] = {
        name: "float16" for name in arrays if name == "mean" or name.startswith("projection_")
    }
    return {**({} if loses_in_halves else fine), "basis": p.packing}


def _facts(
    nominal: Nominal, embedding: Embedding, arrays: Mapping[str, NDArray[Any]], p: PadimParameters
) -> dict[str, Any]:
    warnings = []
    if nominal.presses == 1:
        warnings.append("a single nominal press has no covariance: every deviation counts the same")
    affordable = _affordable(embedding, len(arrays["basis"]), embedding.grid, p)
    if affordable is not None and arrays["basis"].shape[1] == affordable < (p.rank or 0):
        warnings.append(
            f"{affordable} directions per place instead of {p.rank} keep the bank within "
            f"{bank_bytes(p.bank_mb or 0, embedding.grid) / 1e6:.0f} MB"
        )
    return {
        "presses": nominal.presses,
        "channels": embedding.width,
        "rank": int(arrays["basis"].shape[1]),
        "ridge": p.total_ridge,
        "grid": list(embedding.cells),
        "covariances": len(arrays["basis"]),
        "locations": embedding.count - len(arrays.get("elsewhere", ())),
        "locations_shared": len(arrays.get("elsewhere", ())),
        "repairs": list_repairs(p, PAPER, REPAIRS),
        "warnings": warnings,
    }


def emit_squared(graph: Graph, delta: Value, basis: Value, weights: Value, count: int, ridge: float) -> Value:
    """Squared distances (n, m * count) of delta (n, m * count, d): each block of `count` cells under its own basis
    (m, r, d) and weights (m, r).

    One small matrix product per press and block for every n: so a press has the same score alone and in a batch.
    """
    shape = graph.op("Concat", graph.ints(0, -1, count), graph.op("Shape", basis, start=2), axis=0)
    rows = graph.op("Reshape", delta, shape)
    along = graph.op("MatMul", rows, graph.transpose(basis, 0, 2, 1))
    off = graph.op("Sub", rows, graph.op("MatMul", along, basis))
    squared = _sum(graph, along, graph.unsqueeze(weights, 1), off, ridge, 3)
    return graph.reshape(squared, 0, -1)


def _squared_shared(graph: Graph, delta: Value, basis: Value, weights: Value, ridge: float) -> Value:
    """Give the same under one basis (r, d) and weights (r,) for all locations."""
    along = graph.op("MatMul", delta, graph.transpose(basis, 1, 0))
    off = graph.op("Sub", delta, graph.op("MatMul", along, basis))
    return _sum(graph, along, weights, off, ridge, 2)


def _sum(graph: Graph, along: Value, weights: Value, off: Value, ridge: float, *axes: int) -> Value:
    """Weighted squares on the span plus squares off it by the ridge: never negative; inf and NaN stay."""
    weighted = graph.op("Mul", graph.op("Mul", along, along), weights)
    inside = graph.op("ReduceSum", weighted, graph.ints(*axes), keepdims=0)
    outside = graph.op("ReduceSumSquare", off, graph.ints(*axes), keepdims=0)
    return graph.op("Add", inside, graph.op("Mul", outside, graph.scalar(1 / ridge)))
