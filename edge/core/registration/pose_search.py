"""The pose of a press: coarse over all shifts and turns, then fine at two scales."""

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.registration.coarse import CoarseSearch
from edge.core.registration.fine import Alignment, FineSearch

__all__ = ["SIDE_PX", "PoseSearch", "shrunk"]

F32 = NDArray[np.float32]

SIDE_PX = 112
"""The longer side of the picture in which a pose is found; half of that where candidates are refine."""

# Cells along the longer side, and turns, of the coarse search; a peak is found between them. With 28 cells 2 of 336
# presses of six simulated parts got a worse pose, with 32 to 56 cells and 36 to 72 turns at most one.
_COARSE_CELLS, _TURNS = 32, 36
# Poses that are refine, and how often; one more round moves none by a hundredth of a pixel.
_CANDIDATES, _FIRST_ROUNDS, _FINE_ROUNDS = 8, 3, 2
_INSIDE_POWER = 0.05


def shrunk(picture: F32, side: int = SIDE_PX) -> F32:
    """The picture with this longer side, (h, w, c); a smaller one as it is."""
    h, w = picture.shape[:2]
    factor = side / max(h, w)
    if factor >= 1:
        return picture
    size = max(1, round(w * factor)), max(1, round(h * factor))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


class PoseSearch:
    """Finds a part. slopes: float32 (h, w, 2), shrunk. is_turning: False where the part has no turn, as a ball."""

    def __init__(self, slopes: F32, is_turning: bool = True) -> None:
        small, cells = shrunk(slopes, SIDE_PX // 2), shrunk(slopes, _COARSE_CELLS)
        self._factor = max(slopes.shape) / max(small.shape)
        self._cell = max(small.shape) / max(cells.shape)
        self._coarse = CoarseSearch(cells, _TURNS if is_turning else 1)
        self._middle = FineSearch(small, is_turning)
        self._fine = FineSearch(slopes, is_turning)

    def find(self, slopes: F32) -> Alignment:
        """The best pose, in pixels of these slopes, float32 (h, w, 2) in the size of the part's."""
        small = shrunk(slopes, SIDE_PX // 2)
        first = self._coarse.candidates(shrunk(slopes, _COARSE_CELLS), _CANDIDATES)
        tried = self._middle.refine(small, [found.pose.scale(self._cell) for found in first], _FIRST_ROUNDS)
        best = max(tried, key=lambda pose: _worth(*self._middle.agreement(small, pose)))
        return self._fine.align(slopes, best.scale(self._factor), _FINE_ROUNDS)


def _worth(match: float, inside: float) -> float:
    """Weigh a pose: a regular part agrees with itself a pitch further on, where less of it lies in the field.

    The small power lets a clearly better match win all the same.
    """
    return match * float(inside**_INSIDE_POWER)
