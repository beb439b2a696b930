"""What SPADE can be told, and what that means on a grid: cells, windows, averages and blurs."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Grid, Mode, Packing
from plugins.detectors.common.descriptor import resampling_matrix
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM, PAPER_SIGMA_PX, Smoothing, Upsampling, blur_px
from plugins.detectors.common.tile_layout import layout, tile_grid
from plugins.detectors.spade.window import Blocks

__all__ = ["CHUNK", "PAPER", "REPAIRS", "SpadeParameters"]

# SPADE-pytorch src/main.py @077c67b: the gallery (presses, columns, rows) is scanned in chunks of this many cells.
CHUNK = 100


@dataclass(frozen=True)
class SpadeParameters:
    """What SPADE can be told; every repair is a switch of its own.

    Measured as mean AU-PRO up to 1 % false positives and image AUROC on the development set (six random simulated
    parts, 24 nominal presses each), with tactile_resnet18 and, in brackets, untrained ResNet-18.

    layers: the taps compared, finest first. layer1 alone, dims 23: 0.752, 0.987 with 16 presses in the gallery; with
    layer2 on layer2's grid and unit length 0.66; layer1 to layer3 so 0.610, 0.975. descriptor: what stands for a whole
    press: the tap `avgpool`, the spatial means of the layers, or the first of these that the trunk gives. regions: the
    means are of a grid of so many regions a side, so that presses are alike which touch the same places: on the weights
    that ship 0.782 with 1, as published, 0.799 with 4, 0.795 with 8.
    image_neighbours: presses that a press's own score is averaged over. pixel_neighbours: presses in the gallery (the
    two pull in opposite directions, so they are two); on the weights that ship 5 stands at 0.798, 0.982, 6 at 0.799,
    0.985, and the head's time grows with them. cell_mm: layers with smaller cells are averaged over
    2x2, 4x4 ... of them, as long as what results is no larger; None keeps all as they are. window_mm: how far from its
    own place a cell may be matched, None for anywhere: with dims 31 and 8 presses 0.25 stood at 0.751 (0.592), 0.5 at
    0.754 (0.643). dims: leading directions kept at each layer, plus the length of the rest, which makes multiples of
    eight whole; empty keeps all. On the weights that ship 55 0.798, 47 0.795; with regions 1 and 6 presses all 0.784,
    55 0.782, 47 0.779, 31 0.771.
    is_normalised: descriptors divided by their length: 0.706, 0.975 with, where 0.752, 0.987 stood without.
    is_floor_relative: the term that keeps that division finite is a part of the nominal length, so that scaled
    features give the same map, instead of the absolute 1e-6.
    is_gallery_whole: every gallery cell is searched. False re-creates SPADE-pytorch, which scans whole chunks of 100
    cells, column by column, and so never sees the last columns of the last press; it needs a search without window.
    is_balanced: each layer is divided by the median distance between nominal presses, so that none dominates
    by its scale. image_score: `map` is the maximum of the score map, `presses` the mean distance to the
    image neighbours. is_squared: those distances squared, as SPADE-fast has them.
    is_touched_only: cells that no nominal press touches (within margin_mm) keep no rows and are compared with the mean
    of the free gel; it needs a window. sigma: the blur, in `sigma_unit`. is_sampled: a cell's distance is drawn where
    its convolution looks, its top left pixel, instead of at the middle of a square. packing: of the stored cells.
    bank_mb: presses are left out (k-centre) beyond this many megabytes as stored at 224x224, up to four times as many
    for larger frames; None keeps all.
    """

    mode: Mode = "corrected"
    layers: tuple[str, ...] = ("layer1",)
    descriptor: Literal["auto", "avgpool", "means"] = "auto"
    regions: int = 4
    image_neighbours: int = 5
    pixel_neighbours: int = 5
    cell_mm: float | None = 0.127
    window_mm: float | None = 0.5
    dims: tuple[int, ...] = (47,)
    is_normalised: bool = False
    is_floor_relative: bool = True
    is_gallery_whole: bool = True
    is_balanced: bool = True
    image_score: Literal["map", "presses"] = "map"
    is_squared: bool = False
    is_touched_only: bool = True
    margin_mm: float = 1.0
    sigma: float = PAPER_SIGMA_MM
    sigma_unit: Literal["mm", "px"] = "mm"
    is_sampled: bool = True
    packing: Packing = "int8"
    bank_mb: float | None = 16.0

    def __post_init__(self) -> None:
        if not self.layers or len(set(self.layers)) != len(self.layers):
            raise ValueError(f"layers are different tap names, at least one, found {self.layers}")
        if min(self.image_neighbours, self.pixel_neighbours, self.regions) < 1:
            raise ValueError(
                "neighbours and regions are at least 1, found "
                f"{self.image_neighbours}, {self.pixel_neighbours} and {self.regions}"
            )
        if self.dims and (len(self.dims) != len(self.layers) or min(self.dims) < 1):
            raise ValueError(f"dims are one number per layer or none at all, found {self.dims}")
        if self.descriptor not in ("auto", "avgpool", "means") or self.image_score not in ("map", "presses"):
            raise ValueError(f"unknown descriptor '{self.descriptor}' or image_score '{self.image_score}'")
        if self.packing not in ("none", "float16", "int8") or self.sigma_unit not in ("mm", "px"):
            raise ValueError(
                f"packing is none, float16 or int8 and sigma_unit mm or px, found '{self.packing}', '{self.sigma_unit}'"
            )
        if not self.is_gallery_whole and self.window_mm is not None:
            raise ValueError(
                "is_gallery_whole=false leaves out cells of a search without window; set window_mm=null"
            )
        for name in ("cell_mm", "window_mm", "margin_mm", "sigma", "bank_mb"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is at least 0, found {value}")

    def descriptor_taps(self, grid: Grid) -> tuple[str, ...]:
        """The taps whose spatial means describe a whole press (`avgpool` is its own mean)."""
        pooled = self.descriptor == "avgpool" or (self.descriptor == "auto" and "avgpool" in grid.taps)
        return ("avgpool",) if pooled else self.layers

    def regions_of(self, grid: Grid, tap: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The matrices (regions, rows) and (regions, columns) that average a whole tap over its regions."""
        down, across = (
            np.stack([np.isin(np.arange(size), part) / len(part) for part in parts])
            for size in grid.taps[tap][1:]
            for parts in [np.array_split(np.arange(size), min(self.regions, size))]
        )
        return down, across

    def cells(self, grid: Grid, tap: str) -> tuple[int, int]:
        """Rows and columns on which a layer is compared, of one tile where there are tiles."""
        tile = tile_grid(grid)
        h, w = tile.taps[tap][1:]
        if not self.cell_mm:
            return h, w
        own_mm = min(tile.frame[0] / h, tile.frame[1] / w) / grid.pixels_per_mm
        # A hair below a power of two is one.
        side = 2 ** max(0, math.floor(math.log2(self.cell_mm / own_mm) + 0.01))
        return -(-h // side), -(-w // side)

    def count(self, grid: Grid, tap: str) -> int:
        """Cells on which a layer is compared, of all tiles."""
        return math.prod(layout(grid)) * math.prod(self.cells(grid, tap))

    def averaging(self, grid: Grid, tap: str) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """The matrices that average a layer onto its compared cells, None where it stays as it is."""
        own, cells = tile_grid(grid).taps[tap][1:], self.cells(grid, tap)
        if own == cells:
            return None
        rows, columns = (resampling_matrix(n, to, self.is_sampled) for n, to in zip(own, cells, strict=True))
        return rows, columns

    def window(self, grid: Grid, tap: str) -> int | None:
        """How many cells of a tap a match may be away; None for anywhere on the map."""
        if self.window_mm is None:
            return None
        own = self.cells(grid, tap)
        cell_px = min(size / cells for size, cells in zip(tile_grid(grid).frame, own, strict=True))
        # A hair under a whole number of cells must not become one cell more.
        cells = math.ceil(self.window_mm * grid.pixels_per_mm / cell_px - 1e-6)
        return cells if cells < max(own) else None

    def blocks(self, grid: Grid, tap: str) -> Blocks:
        """The blocks in which a layer is searched. Errors: ValueError where it has no window."""
        window = self.window(grid, tap)
        if window is None:
            raise ValueError(f"'{tap}' is searched as a whole; blocks need a window")
        return Blocks(self.cells(grid, tap), window, math.prod(layout(grid)))

    def searched(self, cells: int) -> int:
        """How many gallery cells are searched: all, or whole chunks only; a gallery below one chunk is, whole."""
        return cells if self.is_gallery_whole or cells < CHUNK else cells // CHUNK * CHUNK

    def smoothing(self, grid: Grid, tap: str) -> Smoothing:
        sigma_px = blur_px(self.sigma, self.sigma_unit, grid)
        kind: Upsampling = "sampled" if self.is_sampled else "bilinear"
        (h, w), (down, across) = self.cells(grid, tap), layout(grid)
        return Smoothing((down * h, across * w), grid.frame, sigma_px, kind, grid.tiles)


PAPER = SpadeParameters(
    mode="paper",
    layers=("layer1", "layer2", "layer3"),
    regions=1,
    cell_mm=None,
    window_mm=None,
    dims=(),
    is_normalised=True,
    is_floor_relative=False,
    is_balanced=False,
    image_score="presses",
    is_touched_only=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
    bank_mb=None,
)


REPAIRS = (
    "regions",
    "window_mm",
    "is_normalised",
    "is_floor_relative",
    "is_balanced",
    "image_score",
    "is_touched_only",
    "is_sampled",
)
"""The switches that set the corrected mode apart; the others are operating points."""
