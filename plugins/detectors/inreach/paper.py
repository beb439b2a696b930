"""InReaCh as published: the settings of the paper's code, and its defects.

From the paper and an account of DeclanMcIntosh/InReaCh @a0d54ba, which has no licence and was not copied.
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from edge.core.arrays import F32, F64, Mask
from plugins.detectors.inreach.parameters import InreachParameters, Match, Nearest

__all__ = ["PAPER", "PAPER_TAPS", "REPAIRS", "PublishedInreach"]

# The taps of the published descriptor on Wide-ResNet-50-2; layer3.0 is skipped there.
PAPER_TAPS = (
    "layer1.0", "layer1.1", "layer1.2",
    "layer2.0", "layer2.1", "layer2.2", "layer2.3",
    "layer3.1", "layer3.2", "layer3.3", "layer3.4", "layer3.5",
    "layer4.0",
)  # fmt: skip
# InReaCh.py: the blur of the score map, in pixels of a 224 crop.
PUBLISHED_SIGMA_PX = 13.0


class PublishedInreach(InreachParameters):
    """The parameters with a switch for each published defect; off unless named."""

    is_index_right: bool = Field(
        default=True,
        description="a member is the patch that matched; false: the two patch numbers of a match are swapped",
    )
    is_mutual_sought: bool = Field(
        default=True,
        description="a patch joins the closest mutual realisation; false: it is lost where the closest is not mutual",
    )
    is_tie_local: bool = Field(
        default=True,
        description="among equally near patches the one at the same place wins; false: the first",
    )
    is_minimum_exceeded: bool = Field(
        default=False, description="a channel needs one element more than the minimum"
    )
    is_floored: bool = Field(
        default=True,
        description="a member may also lie as far as 99 % of all members do, so that channels without spread remain",
    )
    is_spread_limited: bool = Field(
        default=True, description="drop channels that are wider than that distance"
    )
    is_fallback: bool = Field(
        default=True, description="every patch is the bank where no channel remains; false: there is no bank"
    )

    def shortest(self, presses: int) -> int:
        return super().shortest(presses) + (self.is_minimum_exceeded and self.length_fraction == 0)

    @property
    def has_fallback(self) -> bool:
        return self.is_fallback

    def prefer(self, asked: F32, seed: F32, nearest: Nearest, match: Match) -> Match:
        """Let the first of equally near patches win: constant gel leaves one pair."""
        return super().prefer(asked, seed, nearest, match) if self.is_tie_local else match

    def is_taken(self, match: Match, best: F32) -> Mask:
        """Tell whether a realisation is the closest so far, mutual or not."""
        return super().is_taken(match, best) if self.is_mutual_sought else match.squared < best

    def member(
        self, opener: NDArray[np.int64], patch: NDArray[np.int64], cells: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Give the two patch numbers of a match in the wrong order."""
        return (opener, patch) if self.is_index_right else (opener // cells * cells + patch, opener % cells)

    def is_near(self, away: F64, limit: F64, stray: float) -> Mask:
        """Keep members strictly closer than the limit, which is 0 for a channel without spread."""
        return super().is_near(away, limit, stray) if self.is_floored else away < limit

    def is_tight(self, spread: F64, stray: float) -> Mask:
        """Keep a channel however wide it is."""
        return super().is_tight(spread, stray) if self.is_spread_limited else np.ones(len(spread), np.bool_)


PAPER = PublishedInreach(
    mode="paper",
    taps=PAPER_TAPS,
    grid_tap="layer1.0",
    descriptor="binned",
    dims=None,
    is_balanced=False,
    is_index_right=False,
    is_mutual_sought=False,
    is_tie_local=False,
    is_minimum_exceeded=True,
    length_fraction=0.0,
    is_floored=False,
    is_spread_limited=False,
    is_touched_only=False,
    most_patches=None,
    is_fallback=False,
    most_rows=None,
    is_squared=True,
    upsampling="nearest",
    sigma=PUBLISHED_SIGMA_PX,
    sigma_unit="px",
    packing="none",
)

REPAIRS = (
    "is_balanced",
    "is_index_right",
    "is_mutual_sought",
    "is_tie_local",
    "is_minimum_exceeded",
    "length_fraction",
    "is_floored",
    "is_spread_limited",
    "is_touched_only",
    "is_fallback",
    "is_squared",
    "upsampling",
)
"""The switches in which the corrected mode differs; the others are operating points."""
