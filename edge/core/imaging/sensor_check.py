"""Checks by coarse colours, before scoring, whether a press is from the sensor of the nominal presses.

The lights of a sensor paint its gel in the same coarse colours at every press; an imprint changes few of them. A
tactile trunk depends on the imprint more than on the light, so a score does not distinguish sensors.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.imaging.quality import Reason, Rejection

__all__ = ["NominalColours", "check_sensor", "colour_cells", "colour_distance"]

F64 = NDArray[np.float64]

# The smallest level of a nominal cell in a ratio: a black corner has no ratio.
_LEAST_LEVEL: Final = 1.0
# Sixty-four times darker than nominal is black, which no lamp's gain explains.
_LEAST_GAIN: Final = 1 / 64


@dataclass(frozen=True)
class NominalColours:
    """The coarse colours of nominal presses. cells: levels, float64 (rows, columns, 3) RGB over the inspected region.

    limit: the largest `colour_distance` of a press from the same sensor.
    """

    cells: F64
    limit: float

    def __post_init__(self) -> None:
        if self.cells.ndim != 3 or self.cells.shape[2] != 3 or not self.cells.size:
            raise ValueError(f"colours are (rows, columns, 3), found {self.cells.shape}")
        if not (self.cells.min() >= 0 and self.cells.max() <= 255 and self.cells.mean() >= _LEAST_LEVEL):
            raise ValueError("colours are levels from 0 to 255, and not all of them black")
        if not self.limit > 0:
            raise ValueError(f"a limit is positive, found {self.limit}")


def colour_cells(rgb: NDArray[np.uint8], shape: tuple[int, int]) -> F64:
    """The mean colour of each of (rows, columns) equal cells, in whole levels. rgb: uint8 (h, w, 3)."""
    rows, columns = shape
    return np.asarray(cv2.resize(rgb, (columns, rows), interpolation=cv2.INTER_AREA), np.float64)


def colour_distance(cells: F64, nominal: F64) -> float:
    """The distance of two sets of coarse colours, as a fraction of the nominal light.

    One common gain is taken out, the median over cells of the ratio of light, so dim or warm lamps do not count. Of the
    residue the largest of the three channels counts in each cell, and of the cells the median. So an imprint on less
    than half of the region changes little.
    """
    light = nominal.mean(axis=2)
    gain = float(np.median(cells.mean(axis=2) / np.maximum(light, _LEAST_LEVEL)))
    residue = np.abs(cells / max(gain, _LEAST_GAIN) - nominal).max(axis=2)
    return float(np.median(residue) / light.mean())


def check_sensor(rgb: NDArray[np.uint8], nominal: NominalColours) -> Rejection | None:
    """Another sensor, or None. rgb: uint8 (h, w, 3), the inspected region."""
    rows, columns = nominal.cells.shape[:2]
    distance = colour_distance(colour_cells(rgb, (rows, columns)), nominal.cells)
    if distance <= nominal.limit:
        return None
    return Rejection(
        Reason.OTHER_SENSOR,
        f"the colours differ by {distance:.1%} of the light from those of the nominal presses, at most "
        f"{nominal.limit:.1%} is accepted; check that this is the sensor of the fit and that all its lights "
        "work, or fit again on it",
    )
