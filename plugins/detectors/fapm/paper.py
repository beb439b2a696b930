"""FAPM as published: the settings of the seed paper's scripts, and the defects of FAPM_official @5d2d2f2."""

from typing import Literal

from pydantic import Field

from plugins.detectors.common.smoothing import PAPER_SIGMA_PX
from plugins.detectors.fapm.parameters import FapmParameters
from plugins.detectors.fapm.steps import COARSE_SIDE, CORRECTED, FINE_SIDE, Cells, Steps, quadrant

__all__ = ["PAPER", "REPAIRS", "PublishedFapm", "steps_of"]


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


def steps_of(p: FapmParameters) -> Steps:
    """The steps with the published defects that the parameters name."""
    if not isinstance(p, PublishedFapm):
        return CORRECTED
    return Steps(
        above=quadrant if p.fusion == "quadrants" else repeated_in_rows,
        shift=CORRECTED.shift if p.is_softmax_stable else lambda distances: distances,
        emit_shift=CORRECTED.emit_shift if p.is_softmax_stable else lambda graph, distances: distances,
        least_weighted=CORRECTED.least_weighted if p.is_single_unweighted else 0,
    )


def repeated_in_rows(row: Cells, column: Cells) -> tuple[Cells, Cells]:
    """The release repeats each of a cell's four coarse values four times in a row: quadrant c falls on fine row c."""
    number = row % FINE_SIDE
    return (
        row // FINE_SIDE * COARSE_SIDE + number // COARSE_SIDE,
        column // FINE_SIDE * COARSE_SIDE + number % COARSE_SIDE,
    )
