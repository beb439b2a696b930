"""The parameters of PaDiM."""

from typing import Self

from pydantic import Field, model_validator

from edge.core.detector import Grid, Packing
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.embedding import EmbeddingChoice
from plugins.detectors.common.parameters import Parameters
from plugins.detectors.common.smoothing import Smoothing, Upsampling

__all__ = ["PadimParameters"]


class PadimParameters(Parameters):
    """The parameters of PaDiM. docs/detectors.md has the measured results of each."""

    taps: shared.Taps = ("layer1",)
    grid_tap: shared.GridTap = "layer1"
    projection: shared.ChannelProjection = "semi_orthogonal"
    channels: shared.Channels = 64
    channel_list: tuple[int, ...] = Field(
        default=(), description="these channels, counted through all taps, instead of a random choice"
    )
    is_balanced: shared.Balanced = True
    is_sampled: shared.Sampled = True
    ridge: float = Field(
        default=0.1,
        gt=0,
        description="added to the diagonal of a covariance; in units of the nominal variance if balanced",
    )
    rank: int | None = Field(default=16, ge=1, description="directions kept at each place; null: all, exact")
    neighbours: int = Field(
        default=1,
        ge=0,
        le=1,
        description="1 fits each place on the 3x3 cells around it, 0 on its own cell alone",
    )
    block: int = Field(
        default=2, ge=1, description="the cells of a square of this side share the mean of their covariances"
    )
    is_touched_only: bool = Field(
        default=True, description="cells that no nominal press touches share one Gaussian"
    )
    margin_mm: shared.MarginMm = 1.0
    sigma: shared.Sigma = 0.19
    sigma_unit: shared.SigmaUnit = "mm"
    packing: Packing = Field(default="int8", description="how the eigenvectors are stored")
    bank_mb: float | None = Field(
        default=16.0,
        gt=0,
        description="a given rank is lowered to stay within this size at 224x224 (four times as much for large "
        "frames); null: no limit",
    )

    @model_validator(mode="after")
    def _makes_an_embedding(self) -> Self:
        _ = self.embedding
        return self

    @property
    def embedding(self) -> EmbeddingChoice:
        return EmbeddingChoice(
            self.taps,
            self.grid_tap,
            self.projection,
            self.channels,
            self.is_balanced,
            self.is_sampled,
            self.channel_list,
        )

    @property
    def total_ridge(self) -> float:
        """The number that is added to the covariance's diagonal before a score is computed."""
        return self.ridge

    def smoothing(self, grid: Grid, cells: tuple[int, int]) -> Smoothing:
        kind: Upsampling = "sampled" if self.is_sampled else "bilinear"
        return Smoothing.of(grid, cells, self.sigma, kind, self.sigma_unit)
