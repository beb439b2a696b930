"""The parameters of PaDiM."""

from pydantic import Field

from edge.core.detector import Packing
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.parameters import EmbeddingParameters

__all__ = ["PadimParameters"]


class PadimParameters(EmbeddingParameters):
    """The parameters of PaDiM. docs/detectors.md has the measured results of each."""

    taps: shared.Taps = ("layer1",)
    grid_tap: shared.GridTap = "layer1"
    channels: shared.Channels = 64
    channel_list: tuple[int, ...] = Field(
        default=(), description="these channels, counted through all taps, instead of a random choice"
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
    margin_mm: shared.MarginMm = 1.0
    sigma: shared.Sigma = 0.19
    packing: Packing = Field(default="int8", description="how the eigenvectors are stored")
    bank_mb: float | None = Field(
        default=16.0,
        gt=0,
        description="a given rank is lowered to stay within this size at 224x224 (four times as much for large "
        "frames); null: no limit",
    )

    @property
    def listed_channels(self) -> tuple[int, ...]:
        return self.channel_list

    @property
    def total_ridge(self) -> float:
        """The number that is added to the covariance's diagonal before a score is computed."""
        return self.ridge
