"""PaDiM as published: the settings of the seed paper's scripts, and their defect."""

from pydantic import Field

from plugins.detectors.common.smoothing import PAPER_SIGMA_PX
from plugins.detectors.padim.parameters import PadimParameters

__all__ = ["PAPER", "REPAIRS", "PublishedPadim"]

# The seed paper's scripts add 0.01 at fit and 0.01 again at prediction; the published implementation adds it once.
PAPER_RIDGE = 0.01
# The seed paper: 550 of the 1792 channels of Wide-ResNet-50-2.
PAPER_CHANNELS = 550


class PublishedPadim(PadimParameters):
    """The parameters with a switch for the published defect; off unless named."""

    is_ridge_twice: bool = Field(
        default=False, description="add the ridge again at prediction, as the seed scripts do"
    )

    @property
    def total_ridge(self) -> float:
        return self.ridge * (2 if self.is_ridge_twice else 1)


PAPER = PublishedPadim(
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
"""The switches in which `corrected` differs from the publication; taps, channels and rank are operating points."""
