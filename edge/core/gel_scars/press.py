"""A scored press in the pixels of the contact view, where the places of a gel are kept; also without the marks."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F32, U8, Mask
from edge.core.contact.reference import View
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.region import Region, touched_in
from edge.core.registration.pose import Registered

__all__ = ["ScoredPress", "measure_moves", "without_marks"]


@dataclass(frozen=True, eq=False)
class ScoredPress:
    """One press as it was scored."""

    score_map: F32
    """float32 (h, w) of the region, raw."""
    limit: float
    """Places above it count as found."""
    region: Region
    """Its place in the picture of `size`."""
    size: tuple[int, int]
    """(width, height)."""
    mm_per_pixel: tuple[float, float]
    """(x, y)."""
    contact: Mask | None = None
    """bool (120, 160) of the view; None where it is not known."""
    unseen: Mask | None = None
    """bool (h, w): places that were not judged."""
    moved_mm: F32 | None = None
    """How far the part's place at each pixel of the view has moved, as `measure_moves`; None where it is not known."""
    without: Callable[[View], F32 | None] = lambda change: None
    """Score map without a change of the gel, (120, 160, 3) levels of the view; None where it cannot be scored."""
    reach: Mask | None = None
    """Where the part is or should be, bool (120, 160); None where that is not known: it may be anywhere."""

    def excess(self) -> F32:
        """Measure how far each pixel of the view is above the limit, float32 (120, 160); 0 outside the region."""
        return self.in_view(np.maximum(self.score_map - np.float32(self.limit), 0))

    def extent(self) -> Mask:
        """Find the pixels of the view that were judged, bool (120, 160)."""
        if self.unseen is None:
            return _whole_extent(self.region, self.size)
        return np.asarray(self.in_view((~self.unseen).astype(np.float32)) > 0)

    def in_view(self, values: F32) -> F32:
        """The largest value in each pixel of the view, float32 (120, 160). values: (h, w) of the region, >= 0."""
        return _in_view(values, self.region, self.size)

    def in_map(self, places: Mask) -> Mask:
        """Places of the view in the map, bool (h, w)."""
        if not places.any():
            return np.zeros(self.score_map.shape, bool)
        return touched_in(places, self.size, self.region)

    def area_mm2(self, places: Mask) -> float:
        """Measure the area of places of the map."""
        return float(np.count_nonzero(places)) * self.mm_per_pixel[0] * self.mm_per_pixel[1]


def _in_view(values: F32, region: Region, size: tuple[int, int]) -> F32:
    if not values.any():
        return np.zeros((VIEW_SIZE[1], VIEW_SIZE[0]), np.float32)
    width, height = size
    picture = np.zeros((height, width), np.float32)
    region.crop(picture)[:] = values
    kernel = np.ones((math.ceil(height / VIEW_SIZE[1]), math.ceil(width / VIEW_SIZE[0])), np.uint8)
    rows, columns = _centres(VIEW_SIZE[1], height), _centres(VIEW_SIZE[0], width)
    return np.asarray(cv2.dilate(picture, kernel).take(rows, 0).take(columns, 1), np.float32)


@cache
def _whole_extent(region: Region, size: tuple[int, int]) -> Mask:
    """The pixels of the view that a region reaches, bool (120, 160)."""
    return np.asarray(_in_view(np.ones((region.height, region.width), np.float32), region, size) > 0)


@cache
def _centres(count: int, size: int) -> NDArray[np.int64]:
    """Where the centres of so many pixels of the view lie on a side of the picture, in its pixels."""
    return np.minimum((np.arange(count) + 0.5) * size / count, size - 1).astype(np.int64)


def measure_moves(
    placed: Registered | None, region: Region, size: tuple[int, int], mm_per_pixel: tuple[float, float]
) -> F32 | None:
    """Measure how far the place of the part that lies at each pixel of the view is from where it lies in the bank: (x,
    y), float32 (2, 120, 160). Where the part turns, places move differently, and that about which it turns does not.
    None where it is not known: one place of a regular part would seem to be several."""
    if placed is None or not placed.is_unique:
        return None
    (left, top), (width, height) = (region.x + 0.5, region.y + 0.5), size
    x, y = np.meshgrid(
        (np.arange(VIEW_SIZE[0]) + 0.5) * width / VIEW_SIZE[0] - left,
        (np.arange(VIEW_SIZE[1]) + 0.5) * height / VIEW_SIZE[1] - top,
    )
    back = cv2.invertAffineTransform(placed.pose.matrix((region.width, region.height)))
    places = np.einsum("ij,jhw->ihw", back, np.stack([x, y, np.ones_like(x)]))
    return np.asarray((np.stack([x, y]) - places) * np.array(mm_per_pixel)[:, None, None], np.float32)


def without_marks(rgb: U8, change: View, size: tuple[int, int], region: Region) -> U8:
    """A picture with a change of the gel taken out, uint8 (h, w, 3).

    rgb: uint8 (h, w, 3) of `region`, in the picture of `size` (width, height). change: of `Marks`, float32 (h', w', 3)
    of the view of the complete picture, levels.
    """
    across, down = change.shape[1] / size[0], change.shape[0] / size[1]
    # From the centre of a pixel of the region to the place in the view.
    places = np.array(
        [[across, 0, (region.x + 0.5) * across - 0.5], [0, down, (region.y + 0.5) * down - 0.5]], np.float64
    )
    wide = cv2.warpAffine(
        change,
        places,
        (region.width, region.height),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(np.clip(np.rint(rgb - wide), 0, 255), np.uint8)
