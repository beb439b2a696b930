"""The parameters of SPADE."""

from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from edge.core.arrays import F64
from edge.core.detector import Grid, Packing
from plugins.detectors.common import parameters as shared
from plugins.detectors.common.parameters import Parameters
from plugins.detectors.common.smoothing import PAPER_SIGMA_MM
from plugins.onnx_builder import Graph, Value

__all__ = ["LENGTH_FLOOR", "SpadeParameters"]

# The seed scripts divide a descriptor by its length plus this.
LENGTH_FLOOR = 1e-6


class SpadeParameters(Parameters):
    """The parameters of SPADE. docs/detectors.md has the measured results of each."""

    layers: tuple[str, ...] = Field(
        default=("layer1",), description="the taps that are compared, finest first"
    )
    descriptor: Literal["auto", "avgpool", "means"] = Field(
        default="auto",
        description="the descriptor of a press: the tap `avgpool`, the spatial means of the layers, or the first "
        "of these that the trunk gives",
    )
    regions: int = Field(default=4, ge=1, description="the means are of this many regions along each side")
    image_neighbours: int = Field(
        default=5, ge=1, description="presses over which the score of a press is averaged"
    )
    pixel_neighbours: int = Field(default=5, ge=1, description="presses in the gallery")
    cell_mm: float | None = Field(
        default=0.127,
        ge=0,
        description="layers with smaller cells are averaged over 2x2, 4x4 ... cells up to this size; null: never",
    )
    window_mm: float | None = Field(
        default=0.5, ge=0, description="how far from its own place a cell may find its match; null: anywhere"
    )
    dims: tuple[int, ...] = Field(
        default=(47,),
        description="leading directions kept at each layer, in addition to the length of the rest; empty: all",
    )
    is_normalised: bool = Field(default=False, description="divide each descriptor by its length")
    is_balanced: bool = Field(
        default=True, description="divide each layer by the median distance between nominal presses"
    )
    image_score: Literal["map", "presses"] = Field(
        default="map", description="the maximum of the score map, or the mean distance to the nearest presses"
    )
    is_squared: bool = Field(default=False, description="square those distances, as SPADE-fast does")
    is_touched_only: bool = Field(
        default=True,
        description="cells that no nominal press touches keep no rows and are compared with the free gel's mean",
    )
    margin_mm: shared.MarginMm = 1.0
    sigma: shared.Sigma = PAPER_SIGMA_MM
    sigma_unit: shared.SigmaUnit = "mm"
    is_sampled: shared.Sampled = True
    packing: Packing = Field(default="int8", description="how the bank is stored")
    bank_mb: float | None = Field(
        default=16.0,
        ge=0,
        description="size at 224x224 (four times as much for large frames) beyond which presses are left out; "
        "null: no limit",
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.layers or len(set(self.layers)) != len(self.layers):
            raise ValueError(f"layers are different tap names, at least one, found {self.layers}")
        if self.dims and (len(self.dims) != len(self.layers) or min(self.dims) < 1):
            raise ValueError(f"dims are one number per layer or none at all, found {self.dims}")
        return self

    def descriptor_taps(self, grid: Grid) -> tuple[str, ...]:
        """The taps whose spatial means describe a complete press (`avgpool` is its own mean)."""
        pooled = self.descriptor == "avgpool" or (self.descriptor == "auto" and "avgpool" in grid.taps)
        return ("avgpool",) if pooled else self.layers

    def regions_of(self, grid: Grid, tap: str) -> tuple[F64, F64]:
        """The matrices (regions, rows) and (regions, columns) that average a tap over its regions."""
        down, across = (
            np.stack([np.isin(np.arange(size), part) / len(part) for part in parts])
            for size in grid.taps[tap][1:]
            for parts in [np.array_split(np.arange(size), min(self.regions, size))]
        )
        return down, across

    def length_floor(self, layer: NDArray[np.floating]) -> float:
        """Find the number to add to a length before the division by it, for a layer (n, c, h, w).

        It is a part of the mean length of a cell's descriptor, so that scaled features give the same map.
        """
        lengths = [np.sqrt(np.square(press, dtype=np.float64).sum(axis=0)).mean() for press in layer]
        return LENGTH_FLOOR * float(np.mean(lengths))

    def gallery_rows(self, gallery: NDArray[np.floating]) -> NDArray[np.floating]:
        """Give the rows (m, c) of a gallery (presses, h, w, c) that are searched without a window: every cell."""
        return gallery.reshape(-1, gallery.shape[3])

    def emit_gallery_rows(self, graph: Graph, bank: Value, size: tuple[int, int, int]) -> Value:
        """Do the same in a graph, for a gallery (m, presses * h * w, c). size: h, w, c."""
        return bank
