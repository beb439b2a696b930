"""The parameters of FAPM."""

from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from edge.core.arrays import F64
from edge.core.detector import Grid
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.parameters import Parameters
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, UPSAMPLING, Smoothing
from plugins.onnx_builder import Graph, Value

__all__ = ["COARSE_SIDE", "FINE_SIDE", "Cells", "FapmParameters"]

# Sub-patches along one side of a cell, fine and coarse: FAPM_official test.py.
FINE_SIDE, COARSE_SIDE = 4, 2

Weighting = Literal["none", "largest", "nearest"]
"""none: the maximum of the map. largest: FAPM's weight, from the farthest of the neighbours (FAPM_official @5d2d2f2).
nearest: that of PatchCore's paper."""

Cells = NDArray[np.int64]


class FapmParameters(Parameters):
    """The parameters of FAPM. docs/detectors.md has the measured results of each."""

    layers: tuple[str, ...] = Field(
        default=("layer1",),
        min_length=1,
        max_length=2,
        description="a fine and a coarse tap, or one alone, which then is the fine one",
    )
    pooling: int = Field(
        default=1, ge=1, description="cells along one side over which a descriptor is averaged, an odd number"
    )
    banks: Literal["location", "cell"] = Field(
        default="cell",
        description="prototypes of each place alone, or shared by the sub-patches of a cell, which forgives shifts",
    )
    near_fraction: float = Field(
        default=0.10,
        gt=0,
        le=1,
        description="part of the nominal descriptors that near cells keep as prototypes",
    )
    far_factor: float = Field(default=2.0, ge=1, description="how many times more prototypes far cells keep")
    far_quantile: float = Field(
        default=0.9,
        ge=0,
        le=1,
        description="cells are far when a descriptor is farther from their near bank than this"
        " quantile of all cells",
    )
    neighbours: int = Field(default=4, ge=1, description="nearest prototypes that a weighting looks at")
    is_calibrated: bool = Field(
        default=False,
        description="divide distances by the cell's median distance between a nominal press and the others' prototypes",
    )
    weighting: Weighting = Field(
        default="none",
        description="the factor of a press's largest distance: none, the published weight from the farthest of "
        "the neighbours, or PatchCore's from the nearest",
    )
    is_touched_only: bool = Field(
        default=True,
        description="cells that no nominal press touches keep no prototypes and are compared with the free gel's mean",
    )
    margin_mm: shared.MarginMm = 1.0
    sigma: shared.Sigma = PAPER_SIGMA_MM
    sigma_unit: shared.SigmaUnit = "mm"
    is_sampled: shared.Sampled = True
    packing: Literal["auto", "none", "float16", "int8"] = Field(
        default="auto",
        description="how the prototypes are stored; auto: the finest that stays within `bank_mb`",
    )
    bank_mb: float = Field(
        default=16.0,
        gt=0,
        description="size at 224x224 (four times as much for large frames) that `auto` stays within; where int8 "
        "is too large it lowers `near_fraction`",
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(set(self.layers)) != len(self.layers):
            raise ValueError(f"layers are a fine and a coarse tap, or one alone, found {self.layers}")
        if self.pooling % 2 == 0:
            raise ValueError(f"pooling is an odd number of cells, found {self.pooling}")
        return self

    @property
    def looked_at(self) -> int:
        """The number of nearest prototypes computed: one where no weighting needs more."""
        return 1 if self.weighting == "none" else self.neighbours

    def smoothing(self, grid: Grid) -> Smoothing:
        return Smoothing.of(
            grid, grid.taps[self.layers[0]][1:], self.sigma, UPSAMPLING[self.is_sampled], self.sigma_unit
        )

    @property
    def least_weighted(self) -> int:
        """The neighbours with which a score has a weight."""
        return 2

    def cover(self, row: Cells, column: Cells) -> tuple[Cells, Cells]:
        """Find the coarse sub-patch whose distance is added to a fine one: the one that covers it."""
        return row // 2, column // 2

    def shift(self, distances: F64) -> F64:
        """Subtract the largest of each row of distances (n, k), so that no exp overflows."""
        shifted: F64 = distances - distances.max(axis=1, keepdims=True)
        return shifted

    def emit_shift(self, graph: Graph, distances: Value) -> Value:
        return graph.op("Sub", distances, graph.op("ReduceMax", distances, graph.ints(1), keepdims=1))

    def weigh(self, distances: F64) -> F64:
        """Find the factor (n,) of a press's largest distance from those to its neighbours (n, k), rising: a softmax."""
        with np.errstate(over="ignore", invalid="ignore"):
            share = np.exp(self.shift(distances))
            share /= share.sum(axis=1, keepdims=True)
        weight: F64 = 1 - (share.max(axis=1) if self.weighting == "largest" else share[:, 0])
        return weight

    def emit_weight(self, graph: Graph, distances: Value) -> Value:
        """Do the same in a graph."""
        grown = graph.op("Exp", self.emit_shift(graph, distances))
        share = graph.op("Div", grown, graph.op("ReduceSum", grown, graph.ints(1), keepdims=1))
        if self.weighting == "nearest":
            return graph.op("Sub", graph.scalar(1.0), graph.first(share, 1))
        return graph.op("Sub", graph.scalar(1.0), graph.op("ReduceMax", share, graph.ints(1), keepdims=0))
