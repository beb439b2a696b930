"""FAPM as published: the settings of the seed paper's scripts, and the defects of FAPM_official @5d2d2f2."""

from typing import Literal

from pydantic import Field

from edge.core.arrays import F64
from plugins.detectors.common.smoothing import PAPER_SIGMA_PX
from plugins.detectors.fapm.parameters import COARSE_SIDE, FINE_SIDE, Cells, FapmParameters
from plugins.onnx_builder import Graph, Value

__all__ = ["PAPER", "REPAIRS", "PublishedFapm"]


class PublishedFapm(FapmParameters):
    """The parameters with a switch for each published defect; off unless named."""

    fusion: Literal["quadrants", "rows"] = Field(
        default="quadrants",
        description="a fine sub-patch gets the coarse one above it, or, as published, that of another quadrant",
    )
    is_softmax_stable: bool = Field(
        default=True, description="subtract the largest distance before exp, which overflows at 88"
    )
    is_single_unweighted: bool = Field(
        default=True, description="no weight where there is one neighbour; false: the weight is 0 there"
    )

    @property
    def least_weighted(self) -> int:
        return super().least_weighted if self.is_single_unweighted else 0

    def cover(self, row: Cells, column: Cells) -> tuple[Cells, Cells]:
        """Take quadrant c for fine row c: the release repeats each of a cell's coarse values four times in a row."""
        if self.fusion == "quadrants":
            return super().cover(row, column)
        number = row % FINE_SIDE
        return (
            row // FINE_SIDE * COARSE_SIDE + number // COARSE_SIDE,
            column // FINE_SIDE * COARSE_SIDE + number % COARSE_SIDE,
        )

    def shift(self, distances: F64) -> F64:
        return super().shift(distances) if self.is_softmax_stable else distances

    def emit_shift(self, graph: Graph, distances: Value) -> Value:
        return super().emit_shift(graph, distances) if self.is_softmax_stable else distances


PAPER = PublishedFapm(
    mode="paper",
    layers=("layer2", "layer3"),
    pooling=3,
    banks="location",
    fusion="rows",
    is_calibrated=False,
    weighting="largest",
    is_softmax_stable=False,
    is_single_unweighted=False,
    is_touched_only=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
)

REPAIRS = (
    "banks",
    "fusion",
    "is_calibrated",
    "weighting",
    "is_softmax_stable",
    "is_single_unweighted",
    "is_touched_only",
    "is_sampled",
)
"""The switches in which the corrected mode differs; the others are operating points."""
