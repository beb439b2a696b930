"""PCA subspace: what a descriptor has outside the span of all nominal descriptors, wherever on the part it was seen.

Idea: the descriptors of all cells of all nominal presses are pooled. Their leading principal directions, up to 99 % of
the variance, are normal. A cell's score is the length of the rest, |delta - U^T U delta|. It is PaDiM's off-span term
without the position. The part may lie anywhere and the bank has kilobytes, but a normal texture in the wrong place is
not found.

Ref: PCA residuals on deep features (SubspaceAD, 2026, on transformer features; here on a convolutional trunk).
"""

from collections.abc import Callable

import numpy as np
from pydantic import Field

from edge.core.arrays import F64
from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Progress, ScoreMaps
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.embedding import Embedded, Embedding, blocks, learn_embedding
from plugins.detectors.common.lowrank import RELATIVE_CUT
from plugins.detectors.common.parameters import EmbeddingParameters, Rng, choose
from plugins.detectors.common.smoothing import PAPER_SIGMA_PX, emit_scores
from plugins.detectors.common.validation import require_fittable, require_scorable
from plugins.onnx_builder import Graph

__all__ = ["SubspaceParameters", "subspace"]


class SubspaceParameters(EmbeddingParameters):
    """The parameters of the PCA subspace. docs/detectors.md has the measured results."""

    taps: shared.Taps = ("layer1", "layer2")
    grid_tap: shared.GridTap = "layer2"
    channels: shared.Channels = 256
    variance: float = Field(
        default=0.99, gt=0, le=1, description="part of the pooled nominal variance that the span explains"
    )
    most_rank: int = Field(
        default=192, ge=1, description="directions of the span at most, which bounds the cost"
    )


# Descriptors are made in float32: a variance below this part of their power is rounding, (6e-8)^2 and a margin.
ROUNDING = 1e-12

# As published: every channel as it is, 99 %. The seed paper has no such method.
PAPER = SubspaceParameters(
    mode="paper",
    taps=("layer1", "layer2", "layer3"),
    projection="all",
    channels=None,
    is_balanced=False,
    is_sampled=False,
    most_rank=4096,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
)


class Subspace:
    """The detector. A press's score is the maximum of its smoothed map."""

    name = "subspace"
    compares_places = False
    is_baseline = True
    keeps_mean = True

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> SubspaceParameters:
        return choose(self.name, PAPER if mode == "paper" else SubspaceParameters(), PAPER, overrides)

    def taps(self, parameters: SubspaceParameters) -> tuple[str, ...]:
        return parameters.taps

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: SubspaceParameters, rng: Rng, progress: Progress
    ) -> Bank:
        """centre (d,) and basis (r, d) of all cells of all presses. Errors: FitError."""
        p = parameters
        require_fittable(self.name, nominal, grid, p.taps)
        rows, columns = grid.taps[p.grid_tap][1:]
        embedding = learn_embedding(p, grid, nominal, np.ones(rows * columns, bool), rng)
        descriptors = embedding.numpy(nominal.features, np.float32)
        centre = _average(descriptors, lambda x: x.sum(axis=(0, 1)), lambda done: progress(done / 2))
        covariance = _average(
            descriptors,
            lambda x: np.tensordot(x - centre, x - centre, axes=((0, 1), (0, 1))),
            lambda done: progress(0.5 + done / 2),
        )
        values, vectors = np.linalg.eigh(covariance)
        values, vectors = np.maximum(values[::-1], 0), vectors[:, ::-1]
        power = float(centre @ centre + values.sum())
        rank = _rank(values, power, p)
        basis = vectors[:, :rank].T if rank else np.zeros((1, embedding.width))
        arrays = {
            **embedding.arrays,
            "centre": centre.astype(np.float32),
            "basis": np.ascontiguousarray(basis, np.float32),
        }
        explained = float(values[:rank].sum() / values.sum()) if values.sum() > 0 else 1.0
        facts = {
            "presses": nominal.presses,
            "channels": embedding.width,
            "rank": rank,
            "variance_explained": round(explained, 6),
            "warnings": []
            if rank
            else ["all nominal descriptors are equal: every deviation counts the same"],
        }
        # The arrays have kilobytes: packing them gains nothing.
        return Bank(arrays, {}, facts)

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: SubspaceParameters
    ) -> ScoreMaps:
        p = parameters
        require_scorable(self.name, features, p.taps)
        embedding = Embedding(p, grid, bank.arrays)
        basis, centre = (bank.arrays[name].astype(np.float64) for name in ("basis", "centre"))
        delta = embedding.numpy(features).at(np.arange(embedding.count)) - centre
        off = delta - delta @ basis.T @ basis
        raw = np.sqrt((off**2).sum(axis=2)).T.reshape(-1, *embedding.cells)
        return p.smoothing(grid, embedding.cells).score_maps(raw)

    def head(self, grid: Grid, bank: Bank, parameters: SubspaceParameters) -> bytes:
        """Taps, `centre` and `basis` in; score_map, score and raw_map out."""
        embedding = Embedding(parameters, grid, bank.arrays)
        graph = Graph("subspace")
        delta = graph.op("Sub", embedding.emit(graph), graph.input("centre", (embedding.width,)))
        basis = graph.input("basis", ("rank", embedding.width))
        along = graph.op("MatMul", delta, graph.transpose(basis, 1, 0))
        off = graph.op("Sub", delta, graph.op("MatMul", along, basis))
        distance = graph.length(off, 2)
        raw = graph.reshape(distance, -1, *embedding.cells)
        emit_scores(graph, raw, parameters.smoothing(grid, embedding.cells))
        return graph.serialise()


subspace = Subspace()


def _rank(values: F64, power: float, p: SubspaceParameters) -> int:
    """The fewest directions that explain the wanted part of the variance.

    values: falling. power: mean square length of a descriptor, which separates variance from rounding. At least one
    direction is left out: with all directions everything would be normal.
    """
    alive = int((values > max(RELATIVE_CUT * values[0], ROUNDING * power)).sum())
    if not alive:
        return 0
    explained = np.cumsum(values[:alive]) / values[:alive].sum()
    wanted = int(np.searchsorted(explained, p.variance - 1e-12)) + 1
    return min(wanted, alive, p.most_rank, len(values) - 1)


def _average(descriptors: Embedded, add: Callable[[F64], F64], progress: Progress) -> F64:
    """Average over all cells and presses the sums that `add` makes of descriptors (cells, n, d)."""
    total, count = np.zeros(()), 0
    every = np.arange(descriptors.embedding.count)
    for part in blocks(len(every)):
        x = descriptors.at(every[part])
        total, count = total + add(x), count + x.shape[0] * x.shape[1]
        progress(part.stop / len(every))
    mean: F64 = total / count
    return mean
