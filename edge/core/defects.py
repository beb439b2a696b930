"""Where on the sensor a defect lies: the connected parts of a score map above the threshold, in pixels and mm; and what
is known of its size and depth."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Defect", "Deviation", "Measured", "find_defects", "longest_extent"]


@dataclass(frozen=True)
class Defect:
    """One connected part above the threshold (diagonal neighbours count as connected)."""

    box_px: tuple[int, int, int, int]
    """(left, top, width, height)."""
    centroid_px: tuple[float, float]
    """(x, y), centre of area; the middle of the first pixel is 0.5. Both from the top left corner of the map."""
    area_px: int
    """Its pixels."""
    score: float
    """The largest in it."""
    inside: NDArray[np.bool_] = field(
        default_factory=lambda: np.ones((1, 1), np.bool_), compare=False, repr=False
    )
    """bool, of its box: its pixels."""


def find_defects(score_map: NDArray[np.floating], threshold: float) -> list[Defect]:
    """Every part above the threshold, highest score first. score_map: (h, w), raw."""
    above = np.ascontiguousarray(score_map > threshold).astype(np.uint8)
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(above, connectivity=8)
    defects = []
    for n in range(1, count):
        left, top, width, height, area = stats[n].tolist()
        box = np.s_[top : top + height, left : left + width]
        inside = labels[box] == n
        # OpenCV puts the middle of the first pixel at 0; half a pixel more makes it agree with the box's edges.
        x, y = (centroids[n] + 0.5).tolist()
        peak = float(score_map[box][inside].max())
        defects.append(Defect((left, top, width, height), (x, y), area, peak, inside))
    return sorted(defects, key=lambda defect: -defect.score)


def longest_extent(places: NDArray[np.bool_]) -> float:
    """Measure from edge to edge of the two pixels that are farthest from each other, pixels. places: bool (h, w), not
    empty."""
    outline = cv2.convexHull(cv2.findNonZero(places.astype(np.uint8)))[:, 0].astype(np.float64)
    return float(np.hypot(*(outline[:, None] - outline[None]).transpose(2, 0, 1)).max()) + 1.0


@dataclass(frozen=True)
class Deviation:
    """What is known of one deviation. A value that is not told from its error is None."""

    depth_mm: float | None = None
    """How much deeper the part is there than a good one; below 0 where it stands out."""
    depth_u95_mm: float | None = None
    """By how much the depth may be wrong, 95 %; without a depth, how deep it may be."""
    size_mm: float | None = None
    """The longest extent of what is above half of the depth."""
    size_u95_mm: float | None = None
    remark: str = ""
    """Why something is None, or less sure than it looks."""


@dataclass(frozen=True)
class Measured:
    """What was measured of one press."""

    calibration: str
    """Its name."""
    deviations: tuple[Deviation, ...] = ()
    """In the order of its defects."""
    reason: str = ""
    """Why nothing was."""
