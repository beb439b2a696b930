"""The parameters of PaDiM."""

from typing import Self

from pydantic import Field, model_validator

from edge.core.detector import Grid, Packing
from plugins.detectors.common.embedding import EmbeddingChoice, Projection
from plugins.detectors.common.parameters import Parameters, Unit
from plugins.detectors.common.smoothing import Smoothing, blur_px

__all__ = ["PadimParameters"]


class PadimParameters(Parameters):
    """The parameters of PaDiM. docs/detectors.md has the measured results of each."""

    taps: tuple[str, ...] = Field(
        default=("layer1",), description="the taps that make a descriptor, in this order"
    )
    grid_tap: str = Field(default="layer1", description="the tap on whose grid descriptors live")
    projection: Projection = Field(
        default="semi_orthogonal",
        description="how channels become fewer: all stay, a random choice of some, or a random orthonormal frame",
    )
    channels: int | None = Field(default=64, ge=1, description="channels that remain; null: all")
    channel_list: tuple[int, ...] = Field(
        default=(), description="these channels, counted through all taps, instead of a random choice"
    )
    is_balanced: bool = Field(
        default=True,
        description="divide each tap by its nominal deviation, so that no tap dominates by its scale",
    )
    is_sampled: bool = Field(
        default=True,
        description="draw a cell at its top left pixel, where its convolution looks, not as a square",
    )
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
    margin_mm: float = Field(
        default=1.0, ge=0, description="places this near to a touched pixel count as touched"
    )
    sigma: float = Field(default=0.19, ge=0, description="the blur, in `sigma_unit`")
    sigma_unit: Unit = Field(
        default="mm", description="whether the blur is the same on the part or in the picture"
    )
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
        sigma_px = blur_px(self.sigma, self.sigma_unit, grid)
        return Smoothing(
            cells, grid.frame, sigma_px, "sampled" if self.is_sampled else "bilinear", grid.tiles
        )
