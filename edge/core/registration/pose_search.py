"""The pose of a press: coarse over all shifts and turns, then fine at two scales."""

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.registration.coarse import Candidate, CoarseSearch
from edge.core.registration.fine import Alignment, FineSearch

__all__ = ["SIDE_PX", "TURNS", "PoseSearch", "shrunk"]

F32 = NDArray[np.float32]

SIDE_PX = 112
"""The longer side of the picture in which a pose is found; half of that in the coarse search."""

TURNS = 72
"""Turns of the coarse search. Half a step, 2.5 degrees, moves the rim of the field by less than two cells."""

_CANDIDATES, _FIRST_ROUNDS, _NEXT_ROUNDS, _FINE_ROUNDS = 6, 3, 2, 3
_INSIDE_POWER = 0.2
# A coarse match within this share of the best may become the best when it is refined.
_NEARLY = 0.8


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
        small = shrunk(slopes, SIDE_PX // 2)
        self._factor = max(slopes.shape) / max(small.shape)
        self._coarse = CoarseSearch(small, TURNS if is_turning else 1)
        self._middle = FineSearch(small, is_turning)
        self._fine = FineSearch(slopes, is_turning)

    def find(self, slopes: F32) -> Alignment:
        """The best pose, in pixels of these slopes, float32 (h, w, 2) in the size of the part's."""
        small = shrunk(slopes, SIDE_PX // 2)
        tried = [
            self._middle.refined(small, found.pose, _FIRST_ROUNDS)
            for found in _worth_trying(self._coarse.candidates(small, _CANDIDATES))
        ]
        best = max(tried, key=lambda pose: _worth(*self._middle.agreement(small, pose)))
        best = self._middle.refined(small, best, _NEXT_ROUNDS)
        return self._fine.aligned(slopes, best.scaled(self._factor), _FINE_ROUNDS)


def _worth_trying(found: list[Candidate]) -> list[Candidate]:
    """Those that fit nearly as well as the best. found: best first."""
    return [one for one in found if one.match >= _NEARLY * found[0].match]


def _worth(match: float, inside: float) -> float:
    """What a pose is worth: a regular part agrees with itself a pitch further on, where less of it lies in the field.

    The small power lets a clearly better match win all the same.
    """
    return match * float(inside**_INSIDE_POWER)
