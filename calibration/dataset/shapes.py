"""Annotated shapes and their pixels: a pixel belongs to a shape when its centre is inside.

Coordinates are continuous, the top left corner of the top left pixel is (0, 0), as in CVAT.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Polygon", "Runs", "Shape", "rasterise"]


@dataclass(frozen=True)
class Polygon:
    """A closed outline; points are (x, y) in pixels. Boxes are polygons of four points."""

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.points) < 3:
            raise ValueError(f"a polygon needs three points, found {len(self.points)}")
        if not np.isfinite(self.points).all():
            raise ValueError("a polygon's points are finite numbers")


@dataclass(frozen=True)
class Runs:
    """A run-length mask in a rectangle: counts alternate good, defect, ... in row order, starting with good."""

    left: int
    top: int
    width: int
    height: int
    counts: tuple[int, ...]

    def __post_init__(self) -> None:
        if min(self.width, self.height) < 1 or min(self.counts, default=-1) < 0:
            raise ValueError("a run-length mask has a positive size and no negative run")
        if sum(self.counts) != self.width * self.height:
            raise ValueError(f"runs sum to {sum(self.counts)}, expected {self.width}x{self.height} pixels")


Shape = Polygon | Runs


def rasterise(shapes: Sequence[Shape], size: tuple[int, int]) -> NDArray[np.bool_]:
    """The union of the shapes, bool (h, w), for a picture of (width, height); what is outside is cut off."""
    mask = np.zeros((size[1], size[0]), np.bool_)
    for shape in shapes:
        if isinstance(shape, Polygon):
            _fill(mask, np.asarray(shape.points, np.float64))
        else:
            _paste(mask, shape)
    return mask


def _fill(mask: NDArray[np.bool_], points: NDArray[np.float64]) -> None:
    """Even-odd filling, row by row: between the first and second edge crossed, the third and fourth, and so on."""
    x0, y0 = points.T
    x1, y1 = np.roll(points, -1, axis=0).T
    first = max(0, int(np.floor(y0.min())))
    last = min(mask.shape[0], int(np.ceil(y0.max())))
    inside = np.zeros(mask.shape[1], np.bool_)
    for row in range(first, last):
        centre = row + 0.5
        crosses = (y0 <= centre) != (y1 <= centre)
        along = (centre - y0[crosses]) / (y1[crosses] - y0[crosses])
        at = np.sort(x0[crosses] + along * (x1[crosses] - x0[crosses]))
        columns = np.clip(np.ceil(at - 0.5), 0, mask.shape[1]).astype(np.intp)
        inside[:] = False
        for start, stop in zip(columns[::2], columns[1::2], strict=True):
            inside[start:stop] = True
        mask[row] |= inside


def _paste(mask: NDArray[np.bool_], runs: Runs) -> None:
    is_defect = np.arange(len(runs.counts)) % 2 == 1
    patch = np.repeat(is_defect, runs.counts).reshape(runs.height, runs.width)
    top, left = max(runs.top, 0), max(runs.left, 0)
    patch = patch[top - runs.top : mask.shape[0] - runs.top, left - runs.left : mask.shape[1] - runs.left]
    mask[top : top + patch.shape[0], left : left + patch.shape[1]] |= patch
