"""The parameters of InReaCh."""

import math
from typing import Self

from pydantic import Field, model_validator

from edge.core.detector import Grid, Packing
from plugins.detectors.common.descriptor import Descriptor, Kind
from plugins.detectors.common.parameters import Parameters, Unit
from plugins.detectors.common.patchbank import PatchBank
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, Smoothing, Upsampling, blur_px

__all__ = ["InreachParameters"]


class InreachParameters(Parameters):
    """The parameters of InReaCh. docs/detectors.md has the measured results of each."""

    taps: tuple[str, ...] = Field(
        default=("layer1",), description="the taps that make a descriptor, in this order"
    )
    grid_tap: str = Field(default="layer1", description="the tap on whose grid descriptors live")
    descriptor: Kind = Field(
        default="cells",
        description="each cell's channels, the published 3x3 windows averaged to bins, or the windows' means",
    )
    dims: int | None = Field(
        default=64,
        ge=1,
        description="leading directions kept, in addition to the length of the rest; null: all",
    )
    is_balanced: bool = Field(
        default=True,
        description="divide each tap by its nominal deviation, so that no tap dominates by its scale",
    )
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
    is_squared: bool = Field(default=False, description="squared distances, as published")
    upsampling: Upsampling = Field(default="sampled", description="how the grid is drawn in pixels")
    sigma: float = Field(default=PAPER_SIGMA_MM, ge=0, description="the blur, in `sigma_unit`")
    sigma_unit: Unit = Field(
        default="mm", description="whether the blur is the same on the part or in the picture"
    )
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
        sigma_px = blur_px(self.sigma, self.sigma_unit, grid)
        cells = grid.taps[self.grid_tap][1:]
        return Smoothing(cells, grid.frame, sigma_px, self.upsampling, grid.tiles)

    def shortest(self, presses: int) -> int:
        """The number of elements that a channel needs."""
        if self.length_fraction > 0:
            depth = min(self.realisations, presses)
            return max(2, math.ceil(self.length_fraction * (presses - 1) / depth))
        return self.minimum_length
