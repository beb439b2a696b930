"""The parameters of FAPM."""

from typing import Literal, Self

from pydantic import Field, model_validator

from edge.core.detector import Grid
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.parameters import Parameters
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, Smoothing, Upsampling
from plugins.detectors.fapm.weighting import Weighting

__all__ = ["FapmParameters"]


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
        kind: Upsampling = "sampled" if self.is_sampled else "bilinear"
        return Smoothing.of(grid, grid.taps[self.layers[0]][1:], self.sigma, kind, self.sigma_unit)
