"""What PaDiM can be told, as published and as corrected."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from edge.core.detector import Grid, Mode, Packing
from plugins.detectors.common.embedding import EmbeddingChoice, Projection
from plugins.detectors.common.smoothing import PAPER_SIGMA_PX, Smoothing, blur_px

__all__ = ["PAPER", "REPAIRS", "PadimParameters"]

# The seed paper's scripts add 0.01 at fit and 0.01 again at prediction; the published implementation adds it once.
PAPER_RIDGE = 0.01
# The seed paper: 550 of the 1792 channels of Wide-ResNet-50-2.
PAPER_CHANNELS = 550


@dataclass(frozen=True)
class PadimParameters:
    """Every choice of PaDiM; the defaults are the corrected mode's default operating point.

    Measured on six random simulated parts, mean AU-PRO up to 1 % false positives with the shipped backbone (with random
    ResNet-18 weights): layer1 and layer2 on layer2's grid 0.601; layer1 alone on its own grid, what touch wants, 0.742
    (0.677); with a covariance per block of 2x2 cells 0.746, and of 4x4 0.748 (0.656); a blur of 0.19 mm instead of
    0.254 then 0.752 (0.679). In blocks of 4x4, rank 8 0.759 (0.62) and all 63 directions (0.59): that weak
    directions count as ridge is part of what works.

    channel_list: these channels, counted through all taps, instead of drawn ones: a published choice.
    ridge: added to the covariance's diagonal; in units of the mean nominal variance where the taps are balanced.
    is_ridge_twice: add it again at prediction, as the seed paper's scripts do. rank: directions kept per location
    (None: all, exact). neighbours: 0, or 1 to fit each location on its 3x3 neighbourhood (tolerates small shifts).
    block: the cells of a square of so many share one covariance, the mean of their own; 1 for each its own.
    sigma: the blur, in `sigma_unit`. is_touched_only: cells that no press touches (within margin_mm) share one
    Gaussian. is_sampled: see EmbeddingChoice. packing: of the eigenvectors. bank_mb: a stated rank is lowered until
    the bank has at most this many megabytes as stored at 224x224, up to four times as many for larger frames.
    """

    mode: Mode = "corrected"
    taps: tuple[str, ...] = ("layer1",)
    grid_tap: str = "layer1"
    projection: Projection = "semi_orthogonal"
    channels: int | None = 64
    channel_list: tuple[int, ...] = ()
    is_balanced: bool = True
    is_sampled: bool = True
    ridge: float = 0.1
    is_ridge_twice: bool = False
    rank: int | None = 16
    neighbours: int = 1
    block: int = 2
    is_touched_only: bool = True
    margin_mm: float = 1.0
    sigma: float = 0.19
    sigma_unit: Literal["mm", "px"] = "mm"
    packing: Packing = "int8"
    bank_mb: float | None = 16.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.ridge) and self.ridge > 0):
            raise ValueError(f"ridge is a positive number, found {self.ridge}")
        if self.rank is not None and self.rank < 1:
            raise ValueError(f"rank is at least 1, or None for exact, found {self.rank}")
        if self.neighbours not in (0, 1):
            raise ValueError(f"neighbours is 0 or 1 (a 3x3 neighbourhood), found {self.neighbours}")
        if self.block < 1:
            raise ValueError(f"block is at least 1 cell, found {self.block}")
        if not self.sigma >= 0 or not self.margin_mm >= 0:
            raise ValueError(f"sigma and margin_mm are at least 0, found {self.sigma} and {self.margin_mm}")
        if self.bank_mb is not None and not self.bank_mb > 0:
            raise ValueError(f"bank_mb is a positive number, or None for no limit, found {self.bank_mb}")
        if self.sigma_unit not in ("mm", "px") or self.packing not in ("none", "float16", "int8"):
            raise ValueError(
                f"sigma_unit is mm or px and packing none, float16 or int8, found {self.sigma_unit}, {self.packing}"
            )
        _ = self.embedding

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
        return self.ridge * (2 if self.is_ridge_twice else 1)

    def smoothing(self, grid: Grid, cells: tuple[int, int]) -> Smoothing:
        sigma_px = blur_px(self.sigma, self.sigma_unit, grid)
        return Smoothing(
            cells, grid.frame, sigma_px, "sampled" if self.is_sampled else "bilinear", grid.tiles
        )


PAPER = PadimParameters(
    mode="paper",
    taps=("layer1", "layer2", "layer3"),
    grid_tap="layer1",
    neighbours=0,
    block=1,
    projection="random",
    channels=PAPER_CHANNELS,
    is_balanced=False,
    is_sampled=False,
    ridge=PAPER_RIDGE,
    is_ridge_twice=True,
    rank=None,
    is_touched_only=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    packing="none",
    bank_mb=None,
)

REPAIRS = (
    "projection",
    "is_balanced",
    "is_sampled",
    "is_ridge_twice",
    "neighbours",
    "is_touched_only",
    "sigma_unit",
)
"""What `corrected` does otherwise than the publication, apart from the operating point (taps, channels, rank)."""
