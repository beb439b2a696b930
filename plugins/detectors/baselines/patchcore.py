"""PatchCore: the distance to the nearest of a few patches that represent all nominal ones, wherever they were seen.

Definition (Roth et al., "Towards total recall in industrial anomaly detection", CVPR 2022), read against
amazon-science/patchcore-inspection @fcaa92f. Binned descriptors of layer2 and layer3 on the grid of layer2; a coreset
of 1 % or 10 % by greedy k-centre, computed in a random projection from ten random points; squared distances. The
press's score is its largest patch distance (the paper's re-weighting is not in the published code).

A baseline for both accuracy and time.
"""

from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from edge.core.arrays import F32
from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.coreset import k_centre
from plugins.detectors.common.descriptor import Descriptor
from plugins.detectors.common.parameters import Parameters, Rng, choose, list_repairs
from plugins.detectors.common.patchbank import PatchBank, draw_rows
from plugins.detectors.common.smoothing import (
    PAPER_SIGMA_MM,
    PAPER_SIGMA_PX,
    UPSAMPLING,
    Smoothing,
    emit_scores,
)
from plugins.detectors.common.validation import require_fittable, require_scorable
from plugins.onnx_builder import Graph

__all__ = ["PatchcoreParameters", "patchcore"]

# patchcore/sampler.py: the approximate greedy search uses this many random dimensions and random points.
PROJECTION_DIMS = 128
STARTING_POINTS = 10


class PatchcoreParameters(Parameters):
    """The parameters of PatchCore. docs/detectors.md has the measured results of each."""

    layers: shared.Taps = ("layer1",)
    grid_tap: shared.GridTap = "layer1"
    descriptor: shared.DescriptorKind = "cells"
    dims: shared.Dims = 64
    is_balanced: shared.Balanced = True
    is_touched_only: bool = Field(
        default=True,
        description="rows are chosen from cells that a nominal press touches and from some free gel",
    )
    coreset_fraction: float = Field(
        default=0.1, gt=0, le=1, description="part of the nominal patches that is kept"
    )
    most_patches: int | None = Field(
        default=16384,
        ge=1,
        description="patches, drawn at random, that the coreset is chosen from at most; null: all",
    )
    most_rows: int | None = Field(default=1024, ge=1, description="rows of the bank at most; null: no limit")
    is_coreset_exact: bool = Field(
        default=True,
        description="k-centre over the descriptors from one start; false: over a random projection with ten random "
        "points as the first bounds, as published",
    )
    is_squared: shared.Squared = False
    image_score: Literal["map", "patches"] = Field(
        default="map",
        description="the maximum of the score map, or the largest distance before upsampling and blur",
    )
    sigma: shared.Sigma = PAPER_SIGMA_MM
    sigma_unit: shared.SigmaUnit = "mm"
    is_sampled: shared.Sampled = True
    packing: Packing = Field(default="float16", description="how the bank is stored")

    @model_validator(mode="after")
    def _makes_rows(self) -> Self:
        _ = self.rows
        return self

    @property
    def rows(self) -> PatchBank:
        descriptor = Descriptor(self.layers, self.grid_tap, self.descriptor, self.is_sampled)
        return PatchBank(descriptor, self.dims, self.is_balanced)

    def smoothing(self, grid: Grid) -> Smoothing:
        return Smoothing.of(
            grid, grid.taps[self.grid_tap][1:], self.sigma, UPSAMPLING[self.is_sampled], self.sigma_unit
        )


PAPER = PatchcoreParameters(
    mode="paper",
    layers=("layer2", "layer3"),
    grid_tap="layer2",
    descriptor="binned",
    dims=None,
    is_balanced=False,
    is_touched_only=False,
    coreset_fraction=0.01,
    most_patches=None,
    most_rows=None,
    is_coreset_exact=False,
    is_squared=True,
    image_score="patches",
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
)


REPAIRS = ("is_balanced", "is_touched_only", "is_coreset_exact", "is_squared", "image_score", "is_sampled")
"""The switches in which the corrected mode differs; the others are operating points."""


class Patchcore:
    """PatchCore under the entry points `gelgate.detectors`."""

    name = "patchcore"
    compares_places = False
    is_baseline = True

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> PatchcoreParameters:
        return choose(self.name, PAPER if mode == "paper" else PatchcoreParameters(), PAPER, overrides)

    def taps(self, parameters: PatchcoreParameters) -> tuple[str, ...]:
        return parameters.layers

    def fit(
        self, nominal: Nominal, grid: Grid, parameters: PatchcoreParameters, rng: Rng, progress: Progress
    ) -> Bank:
        """Keep the coreset: `bank` (rows, width), and `mean`, `basis` and `scales`. Errors: FitError."""
        p = parameters
        require_fittable(self.name, nominal, grid, p.layers)
        arrays, rows = p.rows.learn(nominal.features, grid, rng)
        progress(0.5)
        patches = rows.shape[0] * rows.shape[1]
        count = max(1, int(p.coreset_fraction * patches))
        points = rows.reshape(-1, rows.shape[2])
        free = points[:0]
        if p.is_touched_only:
            points = rows[:, p.rows.touched(nominal, grid)].reshape(-1, rows.shape[2])
            free = p.rows.free_gel(nominal, grid, arrays, rows, rng)
        pressed = draw_rows(points, nominal.limit(p.most_patches), rng)
        points = np.concatenate([pressed, free])
        chosen, facts = _coreset(points, min(count, nominal.limit(p.most_rows) or count), p, rng)
        arrays["bank"] = points[chosen]
        progress(1.0)
        facts |= {
            "presses": nominal.presses,
            "patches": patches,
            "rows": len(chosen),
            "rows_of_free_gel": int((chosen >= len(pressed)).sum()),
            "repairs": list_repairs(p, PAPER, REPAIRS),
            "warnings": [],
        }
        return Bank(arrays, {"bank": p.packing}, facts)

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: PatchcoreParameters
    ) -> ScoreMaps:
        p = parameters
        require_scorable(self.name, features, p.layers)
        raw = p.rows.distances(features, grid, bank.arrays, p.is_squared)
        maps = p.smoothing(grid).score_maps(raw)
        return maps if p.image_score == "map" else ScoreMaps(maps.score_map, raw.max(axis=(1, 2)))

    def head(self, grid: Grid, bank: Bank, parameters: PatchcoreParameters) -> bytes:
        """The graph; the number of rows in the bank is free."""
        p = parameters
        graph = Graph(self.name)
        raw = p.rows.emit(graph, grid, bank, p.is_squared)
        score = None
        if p.image_score == "patches":
            score = graph.op("ReduceMax", raw, graph.ints(1, 2), keepdims=0)
        emit_scores(graph, raw, p.smoothing(grid), score)
        return graph.serialise()


patchcore = Patchcore()


def _coreset(
    points: F32, count: int, p: PatchcoreParameters, rng: Rng
) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """The rows kept, and the random choices made."""
    start = int(rng.integers(len(points)))
    if p.is_coreset_exact:
        coreset = k_centre(points, count, start)
        return coreset.rows, {"start": start, "radius": coreset.radius}
    width = points.shape[1]
    projected = points
    if width > PROJECTION_DIMS:
        projected = (
            points @ rng.uniform(-1, 1, (width, PROJECTION_DIMS)).astype(np.float32) / np.float32(width**0.5)
        )
    first = rng.choice(len(points), min(STARTING_POINTS, len(points)), replace=False)
    bounds = np.stack([np.linalg.norm(projected - projected[k], axis=1) for k in first]).mean(axis=0)
    coreset = k_centre(projected, count, start, bounds.astype(np.float64))
    return coreset.rows, {"starting_points": first.tolist()}
