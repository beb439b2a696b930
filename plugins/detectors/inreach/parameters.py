"""What InReaCh can be told, as published and as corrected."""

import math
from dataclasses import dataclass
from typing import Literal

from edge.core.detector import Grid, Mode, Packing
from plugins.detectors.common.descriptor import Descriptor, Kind
from plugins.detectors.common.patchbank import PatchBank
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, Smoothing, Upsampling, blur_px

__all__ = ["PAPER", "PAPER_TAPS", "REPAIRS", "InreachParameters"]

# The taps of the published descriptor on Wide-ResNet-50-2; layer3.0 is skipped there.
PAPER_TAPS = (
    "layer1.0", "layer1.1", "layer1.2",
    "layer2.0", "layer2.1", "layer2.2", "layer2.3",
    "layer3.1", "layer3.2", "layer3.3", "layer3.4", "layer3.5",
    "layer4.0",
)  # fmt: skip
# InReaCh.py: the blur of the score map, in pixels of a 224 crop.
PUBLISHED_SIGMA_PX = 13.0


@dataclass(frozen=True)
class InreachParameters:
    """What InReaCh can be told; every repair is a switch of its own.

    taps, grid_tap, descriptor: see common/descriptor.py; any trunk's taps will do, and layer1 alone on its own grid is
    what touch wants: see PatchcoreParameters. dims: leading directions kept, plus
    the length of the rest; None keeps all. is_balanced: each tap is divided by its nominal deviation. position_weight:
    two more numbers in each descriptor, the place times this; the published code switches 5.0 on by a test of the
    frames themselves, which a fit from features cannot make.
    realisations: presses that open channels. is_index_right: a member is the patch that matched; published, the two
    patch numbers of a match are swapped. is_mutual_sought: a patch joins the closest realisation that is mutual,
    instead of being lost when the closest of all is not. is_tie_local: among equally near patches the one at the same
    place wins, so that constant gel keeps its channels.
    minimum_length: elements that a channel needs, its opener counted. is_minimum_exceeded: it needs one more, as
    published. length_fraction: when positive, the minimum is this share of what a channel can have, at least 2,
    because few presses cannot make long channels.
    max_dispersion: see the module. is_floored: a member may also lie as far as the stray distance that 99 % of all
    members keep, so that a channel without spread keeps its members. is_spread_limited: channels whose root mean
    square distance exceeds that are dropped.
    is_touched_only: patches are of cells that a nominal press touches; to the bank come a few of free gel.
    most_patches: patches of each press that take part, drawn for each anew; None: all. AU-PRO on those parts with
    400, 640 and 1000: 0.717, 0.737, 0.738; the time of a fit grows with the square.
    is_fallback: when no channel remains the bank is every patch, with a warning, instead of no bank.
    most_rows: the bank is thinned to so many rows by k-centre; None keeps all. On the weights that ship 768, 1024 and
    1536 have 0.802, 0.805 and 0.805. is_squared: squared distances, as
    published. upsampling: of the grid to pixels. sigma: the blur, in `sigma_unit`.
    """

    mode: Mode = "corrected"
    taps: tuple[str, ...] = ("layer1",)
    grid_tap: str = "layer1"
    descriptor: Kind = "cells"
    dims: int | None = 64
    is_balanced: bool = True
    position_weight: float = 0.0
    realisations: int = 10
    is_index_right: bool = True
    is_mutual_sought: bool = True
    is_tie_local: bool = True
    minimum_length: int = 3
    is_minimum_exceeded: bool = False
    length_fraction: float = 0.5
    max_dispersion: float = 5.0
    is_floored: bool = True
    is_spread_limited: bool = True
    is_touched_only: bool = True
    most_patches: int | None = 640
    is_fallback: bool = True
    most_rows: int | None = 1024
    is_squared: bool = False
    upsampling: Upsampling = "sampled"
    sigma: float = PAPER_SIGMA_MM
    sigma_unit: Literal["mm", "px"] = "mm"
    packing: Packing = "float16"

    def __post_init__(self) -> None:
        for name, least in (
            ("realisations", 1),
            ("minimum_length", 1),
            ("length_fraction", 0),
            ("position_weight", 0),
            ("max_dispersion", 0),
            ("sigma", 0),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= least):
                raise ValueError(f"{name} is at least {least}, found {value}")
        for name in ("dims", "most_patches", "most_rows"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} is at least 1, or None for all, found {value}")
        for name, known in (
            ("upsampling", ("sampled", "bilinear", "nearest")),
            ("sigma_unit", ("mm", "px")),
            ("packing", ("none", "float16", "int8")),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is one of {', '.join(known)}, found '{getattr(self, name)}'")
        _ = self.rows

    @property
    def rows(self) -> PatchBank:
        descriptor = Descriptor(self.taps, self.grid_tap, self.descriptor, self.upsampling == "sampled")
        return PatchBank(descriptor, self.dims, self.is_balanced, self.position_weight)

    def smoothing(self, grid: Grid) -> Smoothing:
        sigma_px = blur_px(self.sigma, self.sigma_unit, grid)
        cells = grid.taps[self.grid_tap][1:]
        return Smoothing(cells, grid.frame, sigma_px, self.upsampling, grid.tiles)

    def shortest(self, presses: int) -> int:
        """Elements that a channel needs when there are so many presses."""
        if self.length_fraction > 0:
            depth = min(self.realisations, presses)
            return max(2, math.ceil(self.length_fraction * (presses - 1) / depth))
        return self.minimum_length + self.is_minimum_exceeded


PAPER = InreachParameters(
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
"""The switches that set the corrected mode apart; the others are operating points."""
