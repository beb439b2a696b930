"""Where on the sensor a defect lies: the connected parts of a score map above the threshold, in pixels and mm."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Defect", "find_defects"]


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


def find_defects(score_map: NDArray[np.floating], threshold: float) -> list[Defect]:
    """Every part above the threshold, highest score first. score_map: (h, w), raw."""
    above = np.ascontiguousarray(score_map > threshold).astype(np.uint8)
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(above, connectivity=8)
    defects = []
    for n in range(1, count):
        left, top, width, height, _ = stats[n]
        box = np.s_[top : top + height, left : left + width]
        highest = score_map[box][labels[box] == n].max()
        defects.append(_defect(stats[n], centroids[n], float(highest)))
    return sorted(defects, key=lambda defect: -defect.score)


def _defect(stats: NDArray[np.int32], centroid: NDArray[np.float64], peak: float) -> Defect:
    left, top, width, height, area = (int(value) for value in stats)
    # OpenCV puts the middle of the first pixel at 0; half a pixel more makes it agree with the box's edges.
    x, y = (float(value) + 0.5 for value in centroid)
    return Defect((left, top, width, height), (x, y), area, peak)
