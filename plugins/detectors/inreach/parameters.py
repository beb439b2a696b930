"""The parameters of InReaCh."""

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from edge.core.arrays import F32, F64, Mask
from edge.core.detector import Grid, Packing
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.descriptor import Descriptor
from plugins.detectors.common.parameters import Parameters
from plugins.detectors.common.patchbank import PatchBank
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, Smoothing, Upsampling

__all__ = ["InreachParameters", "Match", "Nearest", "squared_distances"]

# Two distances that differ by less than this part are equal: rounding of float32.
EQUAL = 1e-5
# A squared distance below this part of the two squared lengths is rounding of the product, in float32.
ROUNDING = 1e-6


class Match(NamedTuple):
    """The nearest patches between a press and one realisation, with exact distances."""

    squared: F32
    """The squared distances of the press's patches, float32 (cells,)."""
    there: NDArray[np.int64]
    """Int64 (cells,), for each patch of the press its nearest of the realisation."""
    back: NDArray[np.int64]
    """The other direction, -1 for none."""

    @property
    def is_mutual(self) -> Mask:
        """Tell whether the nearest patch of a press's nearest patch is that one, (cells,)."""
        mutual: Mask = self.back[self.there] == np.arange(len(self.there))
        return mutual


class Nearest(NamedTuple):
    """Both directions between a press and each of k realisations, by the product."""

    there: NDArray[np.int64]
    """Int64 (k, cells), for each patch of the press the nearest of the realisation."""
    away: F32
    """Float32 (k, cells), its squared distance."""
    back: F32
    """Float32 (k, cells), for each patch of the realisation the distance to the nearest patch of the press."""
    lengths: F32
    """Float32 (k, cells), the sum of the squared lengths of both patches at each place."""


def squared_distances(a: F32, b: F32) -> F32:
    """Compute squared distances (p,) of rows (p, c), as sums of squared differences."""
    difference = a - b
    squares: F32 = np.einsum("pc,pc->p", difference, difference)
    return squares


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

    @property
    def has_fallback(self) -> bool:
        """Tell whether every patch is the bank where no channel remains."""
        return True

    def prefer(self, asked: F32, seed: F32, nearest: Nearest, match: Match) -> Match:
        """Prefer the same place among equally near patches, so that constant gel keeps its channels."""
        every, here = np.arange(len(asked)), squared_distances(asked, seed)
        is_there = here <= match.squared * (1 + EQUAL)
        is_back = here <= np.maximum(nearest.back, 0) * (1 + EQUAL) + ROUNDING * nearest.lengths
        return Match(
            np.where(is_there, here, match.squared),
            np.where(is_there, every, match.there),
            np.where(is_back, every, match.back),
        )

    def is_taken(self, match: Match, best: F32) -> Mask:
        """Tell which patches join a realisation: closer than the best so far, and mutual.

        The others may still join another one.
        """
        return (match.squared < best) & match.is_mutual

    def member(
        self, opener: NDArray[np.int64], patch: NDArray[np.int64], cells: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Give the key of the channel and its member: opener and matched patch."""
        return opener, patch

    def is_near(self, away: F64, limit: F64, stray: float) -> Mask:
        """Tell which members stay: within their channel's limit, or as near as most members of all channels."""
        return away <= np.maximum(limit, stray)

    def is_tight(self, spread: F64, stray: float) -> Mask:
        """Tell which channels stay: those not wider than the stray distance, by their root mean square distance."""
        return spread <= stray * (1 + EQUAL)
