"""What a press adds to the light of the free gel, as if every place were lit like the middle.

The lights reach the corners of the gel weakly, and a slope there shows its colour as weakly. So what a press adds is
divided by the free gel's own light: then a part shows the same wherever it lies.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import fit_levels

__all__ = ["FreeLight"]

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

# The light is the free gel without its grain and dust, as a share of its median; weaker places would amplify noise.
_SMOOTH_SHARE = 0.05
_LEAST_LIGHT = 0.2
# The level is fitted on a picture of about this size, as contact detection does.
_LEVEL_SIDE_PX = 112


class FreeLight:
    """The free gel of a sensor. free: uint8 (h, w, 3)."""

    def __init__(self, free: U8) -> None:
        self._free = free.astype(np.float32)
        smooth = cv2.GaussianBlur(self._free, (0, 0), _SMOOTH_SHARE * max(free.shape))
        middle = np.maximum(np.median(smooth, axis=(0, 1)), 1.0)
        self._light = np.maximum(smooth / middle, np.float32(_LEAST_LIGHT))
        self._inverse = 1 / self._light
        self._small = _level_view(free)

    def find_change(self, rgb: U8) -> F32:
        """Find what a press adds, float32 (h, w, 3), levels in the middle of the gel. rgb: uint8 (h, w, 3)."""
        levels = fit_levels(_level_view(rgb), self._small)
        scale, offset = levels.gain.astype(np.float64), levels.offset.astype(np.float64)
        matrix = np.concatenate([np.diag(scale), offset[:, None]], axis=1)
        added = np.asarray(cv2.transform(rgb.astype(np.float32), matrix), np.float32)
        added -= self._free
        added *= self._inverse
        return np.asarray(added, np.float32)

    def picture(self, added: F32) -> U8:
        """The press that adds this, uint8 (h, w, 3)."""
        return np.asarray(cv2.convertScaleAbs(np.maximum(self.levels(added), 0)), np.uint8)

    def levels(self, added: F32) -> F32:
        """The levels of the press that adds this, float32 (h, w, 3), neither rounded nor clipped."""
        return np.asarray(self._free + self._light * added, np.float32)

    def apply_change(self, levels: F32, change: F32, weight: F32) -> U8:
        """Make a picture with these levels and a weighted change of what is added, uint8 (h, w, 3). weight: (h, w)."""
        shows = cv2.multiply(cv2.cvtColor(weight, cv2.COLOR_GRAY2RGB), self._light)
        return np.asarray(cv2.add(levels, cv2.multiply(change, shows, dst=shows), dtype=cv2.CV_8U), np.uint8)


def _level_view(rgb: U8) -> F32:
    factor = _LEVEL_SIDE_PX / max(rgb.shape)
    if factor >= 1:
        return rgb.astype(np.float32)
    return cv2.resize(rgb, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA).astype(np.float32)
