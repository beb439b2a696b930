"""The parameters of InReaCh."""

import math
from typing import Self

from pydantic import Field, model_validator

from edge.core.detector import Grid, Packing
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.descriptor import Descriptor
from plugins.detectors.common.parameters import Parameters
from plugins.detectors.common.patchbank import PatchBank
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, Smoothing, Upsampling

__all__ = ["InreachParameters"]


class InreachParameters(Parameters):
    """The parameters of InReaCh. docs/detectors.md has the measured results of each."""

    taps: shared.Taps = ("layer1",)
    grid_tap: shared.GridTap = "layer1"
    descriptor: shared.DescriptorKind = "cells"
    dims: shared.Dims = 64
    is_balanced: shared.Balanced = True
    position_weight: float = Field(
        default=0.0,
        ge=0,
        description="the place on the grid, 0 to 1 down and across, times this is added to a descriptor",
    )
    realisations: int = Field(default=10, ge=1, description="presses whose patches open channels")
    minimum_length: int = Field(
        default=3,
        ge=1,
        description="elements that a channel needs, including its opener, where `length_fraction` is 0",
    )
    length_fraction: float = Field(
        default=0.5,
        ge=0,
        description="above 0: a channel needs this share of the elements that it can have, at least 2",
    )
    max_dispersion: float = Field(
        default=5.0,
        ge=0,
        description="a member may lie this many standard deviations of the members' distances from their mean",
    )
    is_touched_only: bool = Field(
        default=True,
        description="only cells that a nominal press touches take part; some free gel is added to the bank",
    )
    most_patches: int | None = Field(
        default=640,
        ge=1,
        description="patches of each press that take part, drawn for each of them; null: all",
    )
    most_rows: int | None = Field(
        default=1024, ge=1, description="rows of the bank at most, chosen by k-centre; null: no limit"
    )
    is_squared: shared.Squared = False
    upsampling: Upsampling = Field(default="sampled", description="how the grid is drawn in pixels")
    sigma: shared.Sigma = PAPER_SIGMA_MM
    sigma_unit: shared.SigmaUnit = "mm"
    packing: Packing = Field(default="float16", description="how the bank is stored")

    @model_validator(mode="after")
    def _makes_rows(self) -> Self:
        _ = self.rows
        return self

    @property
    def rows(self) -> PatchBank:
        descriptor = Descriptor(self.taps, self.grid_tap, self.descriptor, self.upsampling == "sampled")
        return PatchBank(descriptor, self.dims, self.is_balanced, self.position_weight)

    def smoothing(self, grid: Grid) -> Smoothing:
        return Smoothing.of(grid, grid.taps[self.grid_tap][1:], self.sigma, self.upsampling, self.sigma_unit)

    def shortest(self, presses: int) -> int:
        """The number of elements that a channel needs."""
        if self.length_fraction > 0:
            depth = min(self.realisations, presses)
            return max(2, math.ceil(self.length_fraction * (presses - 1) / depth))
        return self.minimum_length
