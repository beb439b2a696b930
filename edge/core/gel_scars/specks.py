"""What lies on the free gel press after press, though no press exceeds its limit by it: dust, hairs and scars."""

from typing import Final, final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import Mask
from edge.core.imaging.decode import VIEW_SIZE

__all__ = ["LASTING", "Specks"]

LASTING: Final = 5
"""Presses before which the free gel shows the same mark until it is said. One before which it does not takes two back:
a faint mark is not seen each time."""
_BACK: Final = 2

# A mark is seen up to two pixels of the view (0.25 mm) elsewhere before the next press.
_NEAR: Final = np.ones((5, 5), np.uint8)


@final
class Specks:
    """Counts before how many presses the free gel shows a mark at a place."""

    def __init__(self) -> None:
        self._times: NDArray[np.int64] = np.zeros((VIEW_SIZE[1], VIEW_SIZE[0]), np.int64)
        self._seen: Mask = np.zeros(self._times.shape, bool)

    def see(self, clear: Mask) -> None:
        """Take the clear marks of the free gel before a press, bool (120, 160)."""
        near = cv2.dilate(clear.astype(np.uint8), _NEAR) > 0
        self._times, self._seen = np.clip(self._times + np.where(near, 1, -_BACK), 0, LASTING), clear

    @property
    def lasting(self) -> Mask:
        """Find the marks of the newest picture that were there often enough, bool (120, 160)."""
        return np.asarray(self._seen & (self._times == LASTING))
