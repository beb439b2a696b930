"""From a small grid of distances to a smooth score map in pixels, as two exact matrices.

Upsampling and Gaussian blur are both linear and separable. With U the upsampling matrix and G the blur matrix of one
axis, `map = R_rows @ grid @ R_cols.T` where `R = G @ U`. Two small matrix products replace an interpolation and a
filter over the full map, with the same numbers in float64 NumPy and in the graph.

Source: torch bilinear (align_corners False, no antialias), torch nearest, scipy.ndimage.gaussian_filter with its
defaults; tests/detectors/test_smoothing.py compares each with the original.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from edge.core.arrays import F64
from edge.core.detector import Grid, ScoreMaps
from edge.core.imaging.tiles import Tiles
from plugins.onnx_builder import Graph, Value

__all__ = [
    "PAPER_SIGMA_MM",
    "PAPER_SIGMA_PX",
    "UPSAMPLING",
    "Border",
    "Smoothing",
    "Upsampling",
    "emit_scores",
    "gaussian_matrix",
    "smoothing_matrix",
    "upsampling_matrix",
]

Upsampling = Literal["bilinear", "nearest", "sampled"]
"""bilinear and nearest take a cell as a square of pixels (the published way). sampled takes it as a sample at its top
left pixel, the centre of strided convolutions with symmetric padding, and is bilinear between such samples."""

UPSAMPLING: Mapping[bool, Upsampling] = {True: "sampled", False: "bilinear"}
"""By whether a cell is a sample."""

Border = Literal["symmetric", "reflect"]
"""What a blur sees beyond the border: symmetric repeats the edge sample (scipy's `reflect`), reflect does not, as torch
names it."""

# The blur of the published implementations, in pixels of a 224 crop (SPADE-pytorch, PaDiM, FAPM).
PAPER_SIGMA_PX = 4.0
# The same at 320x240, where a millimetre is 15.77 pixels.
PAPER_SIGMA_MM = PAPER_SIGMA_PX / 15.77
# scipy.ndimage.gaussian_filter cuts its kernel at four sigma.
TRUNCATE = 4.0


@cache
def upsampling_matrix(cells: int, pixels: int, kind: Upsampling = "bilinear") -> F64:
    """Upsample one axis: float64 (pixels, cells), each row sums to 1.

    bilinear: half-pixel centres, edges clamped. nearest: floor(pixel * cells / pixels). sampled: cell i is at pixel
    i * stride; the stride is the power of two that the sizes imply.
    """
    if cells < 1 or pixels < 1:
        raise ValueError(f"an axis has at least one cell and one pixel, found {cells} and {pixels}")
    matrix = np.zeros((pixels, cells))
    rows = np.arange(pixels)
    if kind == "nearest":
        matrix[rows, rows * cells // pixels] = 1.0
    else:
        centre = rows / _stride(cells, pixels) if kind == "sampled" else (rows + 0.5) * cells / pixels - 0.5
        centre = np.clip(centre, 0, cells - 1)
        low = np.floor(centre).astype(np.int64)
        np.add.at(matrix, (rows, low), 1 - (centre - low))
        np.add.at(matrix, (rows, np.minimum(low + 1, cells - 1)), centre - low)
    matrix.flags.writeable = False
    return matrix


def _stride(cells: int, pixels: int) -> float:
    """Pixels per cell: 4 for 56 of 224 and also for 57 of 226, where the convolutions round up."""
    return float(2 ** round(np.log2(pixels / cells))) if cells < pixels else pixels / cells


@cache
def gaussian_matrix(pixels: int, sigma_px: float, border: Border = "symmetric") -> F64:
    """Blur one axis by a Gaussian: float64 (pixels, pixels), each row sums to 1. Sigma 0 changes nothing."""
    if not (np.isfinite(sigma_px) and sigma_px >= 0):
        raise ValueError(f"a blur is a finite number of pixels, at least 0, found {sigma_px}")
    radius = int(TRUNCATE * sigma_px + 0.5)
    offsets = np.arange(-radius, radius + 1)
    kernel = (
        np.exp(-0.5 * (offsets / max(sigma_px, np.finfo(np.float64).tiny)) ** 2) if radius else np.ones(1)
    )
    kernel /= kernel.sum()
    source = np.pad(np.arange(pixels), radius, mode=border)
    matrix = np.zeros((pixels, pixels))
    for step, weight in enumerate(kernel):
        np.add.at(matrix, (np.arange(pixels), source[step : step + pixels]), weight)
    matrix.flags.writeable = False
    return matrix


@cache
def smoothing_matrix(
    cells: int, pixels: int, sigma_px: float, kind: Upsampling = "bilinear", border: Border = "symmetric"
) -> F64:
    """Upsampling then blur of one axis: R = G U, float64 (pixels, cells)."""
    matrix = gaussian_matrix(pixels, sigma_px, border) @ upsampling_matrix(cells, pixels, kind)
    matrix.flags.writeable = False
    return matrix


@dataclass(frozen=True)
class Smoothing:
    """How a grid of raw distances becomes the score map."""

    cells: tuple[int, int]
    """(rows, columns) of the grid."""
    frame: tuple[int, int]
    """(h, w) in pixels."""
    sigma_px: float
    """The blur, in pixels of the frame."""
    upsampling: Upsampling = "bilinear"
    tiles: Tiles | None = None
    """Set where the grid is a mosaic of tiles: they are blended first, so that no blur crosses the edge of a tile."""

    @classmethod
    def of(
        cls,
        grid: Grid,
        cells: tuple[int, int],
        sigma: float,
        upsampling: Upsampling = "bilinear",
        unit: Literal["mm", "px"] = "mm",
    ) -> "Smoothing":
        """Blur by a physical size, the same on the part at every resolution, or by pixels of the frame."""
        sigma_px = sigma * (grid.pixels_per_mm if unit == "mm" else 1.0)
        return cls(cells, grid.frame, sigma_px, upsampling, grid.tiles)

    @property
    def rows(self) -> F64:
        """float64 (h, grid rows)."""
        if self.tiles is None:
            return smoothing_matrix(self.cells[0], self.frame[0], self.sigma_px, self.upsampling)
        return self._over(self.tiles.blend_rows(self.cells[0] // len(self.tiles.rows)), self.frame[0])

    @property
    def columns(self) -> F64:
        """float64 (w, grid columns)."""
        if self.tiles is None:
            return smoothing_matrix(self.cells[1], self.frame[1], self.sigma_px, self.upsampling)
        return self._over(self.tiles.blend_columns(self.cells[1] // len(self.tiles.columns)), self.frame[1])

    def _over(self, blend: F64, pixels: int) -> F64:
        """Blend one axis of a mosaic onto the frame's own grid, then upsample and blur it."""
        return smoothing_matrix(len(blend), pixels, self.sigma_px, self.upsampling) @ blend

    def __call__(self, raw: F64) -> F64:
        """The smooth map, float64 (n, h, w), of raw distances (n, grid rows, grid columns)."""
        smooth: F64 = self.rows @ raw.astype(np.float64) @ self.columns.T
        return smooth

    def score_maps(self, raw: F64) -> ScoreMaps:
        """The oracle's result for raw distances: the smooth map, and its maximum as the press's score."""
        score_map = self(raw)
        return ScoreMaps(score_map, score_map.max(axis=(1, 2)))


def emit_scores(graph: Graph, raw: Value, smoothing: Smoothing, score: Value | None = None) -> None:
    """Finish a head: from raw distances (n, rows, columns) to its outputs `score_map`, `score` and `raw_map`.

    score: a press's score (n,) where the method has its own; otherwise the maximum of the map. `raw_map` is the
    grid before upsampling and blur, float32 (n, rows, columns), from which tiles are blended.
    """
    smooth = graph.between(smoothing.rows, raw, smoothing.columns)
    if score is None:
        score = graph.op("ReduceMax", smooth, graph.ints(1, 2), keepdims=0)
    graph.output("score_map", smooth, ("n", *smoothing.frame))
    graph.output("score", score, ("n",))
    graph.output("raw_map", raw, ("n", *smoothing.cells))
