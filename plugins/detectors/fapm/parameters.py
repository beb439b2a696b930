"""What FAPM can be told, as published and as corrected."""

import math
from dataclasses import dataclass
from typing import Literal

from edge.core.detector import Grid, Mode, Packing
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, PAPER_SIGMA_PX, Smoothing, Upsampling, blur_px
from plugins.detectors.fapm.weighting import Weighting

__all__ = ["PAPER", "REPAIRS", "FapmParameters"]


@dataclass(frozen=True)
class FapmParameters:
    """What FAPM can be told; every repair is a switch of its own.

    Measured as mean AU-PRO up to 1 % false positives and image AUROC on the development set (six random simulated
    parts, 24 nominal presses each), with tactile_resnet18 and, in brackets, untrained ResNet-18.

    layers: a fine and a coarse tap, or one alone, which then is the fine one. layer1: 0.762, 0.992 (0.637); with layer2
    added at half its weight 0.728, 0.989 (0.559); layer2 with layer3 0.485, 0.973. pooling: cells along one side that a
    descriptor is averaged over, an odd number. Calibrated, 3 stood at 0.710 (0.524) and 1 at 0.721 (0.633).
    banks: `location` keeps prototypes for each place (the seed paper), `cell` shares them
    among the sub-patches of a cell (the official code), which tolerates a shifted press. near_fraction, far_factor:
    prototypes kept, and how many times more in far cells; 0.05 stood at 0.763, 0.986 (0.622), 0.2 at 0.761, 0.992
    (0.639). far_quantile: which cells are far. neighbours: nearest prototypes that a weighting looks at.
    fusion: `quadrants` gives each fine sub-patch the coarse one above it, `rows` is the published layout, which gives
    half of them another quadrant's. is_calibrated: distances are divided by the cell's median distance between a
    nominal press and the prototypes of others: 0.721, 0.982 (0.633) with it.
    weighting: what multiplies the press's largest distance: `none` takes the maximum of the score map, `largest` is the
    published weight from the farthest of the neighbours, `nearest` the one of PatchCore's paper.
    is_softmax_stable: the weight survives distances above 88. is_single_unweighted: no weight where there is but one
    neighbour, instead of the weight 0. is_touched_only: cells that no nominal press touches (within margin_mm) keep no
    prototypes and are compared with the mean of the free gel.
    sigma: the blur, in `sigma_unit`. is_sampled: a cell's distance is drawn where its convolution looks, its top left
    pixel. packing: of the prototypes; `auto` is the finest that stays within bank_mb megabytes (at 224x224, up to four
    times as many for larger frames), and lowers near_fraction where even int8 does not.
    """

    mode: Mode = "corrected"
    layers: tuple[str, ...] = ("layer1",)
    pooling: int = 1
    banks: Literal["location", "cell"] = "cell"
    near_fraction: float = 0.10
    far_factor: float = 2.0
    far_quantile: float = 0.9
    neighbours: int = 4
    fusion: Literal["quadrants", "rows"] = "quadrants"
    is_calibrated: bool = False
    weighting: Weighting = "none"
    is_softmax_stable: bool = True
    is_single_unweighted: bool = True
    is_touched_only: bool = True
    margin_mm: float = 1.0
    sigma: float = PAPER_SIGMA_MM
    sigma_unit: Literal["mm", "px"] = "mm"
    is_sampled: bool = True
    packing: Packing | Literal["auto"] = "auto"
    bank_mb: float = 16.0

    def __post_init__(self) -> None:
        if len(self.layers) not in (1, 2) or len(set(self.layers)) != len(self.layers):
            raise ValueError(f"layers are a fine and a coarse tap, or one alone, found {self.layers}")
        if self.pooling < 1 or self.pooling % 2 == 0:
            raise ValueError(f"pooling is an odd number of cells, found {self.pooling}")
        if not (0 < self.near_fraction <= 1 and self.far_factor >= 1 and 0 <= self.far_quantile <= 1):
            raise ValueError(
                "near_fraction lies in (0, 1], far_factor is at least 1 and far_quantile lies in [0, 1], "
                f"found {self.near_fraction}, {self.far_factor}, {self.far_quantile}"
            )
        if self.neighbours < 1 or not self.bank_mb > 0:
            raise ValueError(
                f"neighbours is at least 1 and bank_mb positive, found {self.neighbours}, {self.bank_mb}"
            )
        for name in ("sigma", "margin_mm"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"{name} is at least 0, found {getattr(self, name)}")
        for name, known in (
            ("banks", ("location", "cell")),
            ("fusion", ("quadrants", "rows")),
            ("weighting", ("none", "largest", "nearest")),
            ("sigma_unit", ("mm", "px")),
            ("packing", ("auto", "none", "float16", "int8")),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is one of {', '.join(known)}, found '{getattr(self, name)}'")

    @property
    def looked_at(self) -> int:
        """Nearest prototypes measured: one where nothing weighs them."""
        return 1 if self.weighting == "none" else self.neighbours

    def smoothing(self, grid: Grid) -> Smoothing:
        sigma_px = blur_px(self.sigma, self.sigma_unit, grid)
        cells = grid.taps[self.layers[0]][1:]
        kind: Upsampling = "sampled" if self.is_sampled else "bilinear"
        return Smoothing(cells, grid.frame, sigma_px, kind, grid.tiles)


PAPER = FapmParameters(
    mode="paper",
    layers=("layer2", "layer3"),
    pooling=3,
    banks="location",
    fusion="rows",
    is_calibrated=False,
    weighting="largest",
    is_softmax_stable=False,
    is_single_unweighted=False,
    is_touched_only=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
)


REPAIRS = (
    "banks",
    "fusion",
    "is_calibrated",
    "weighting",
    "is_softmax_stable",
    "is_single_unweighted",
    "is_touched_only",
    "is_sampled",
)
"""The switches that set the corrected mode apart; the others are operating points."""
