"""Light that has changed slowly since the fit: followed where the free gel proves that light alone has changed.

The free gel of now is brought to that of the fit by one gain and one offset for each colour. Where nothing else remains
it is the same gel under another light, and a press is brought to the light of the fit in the same way. Another gel,
another unit and a lamp that fails on one side leave more: then nothing is changed, and what is charted says so.

Ref: measured on simulated gels, in levels of nine tenths of the 160x120 view: 0.8 to 1.1 after a lamp with 80 to 110 %
of its light, all colours or one; 5.4 where it falls by a tenth on one side; 11 to 13 between two units. Noise of single
pixels is taken out first.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import View, fit_levels

__all__ = ["FollowedLight", "find_light"]

# What nine tenths of the free gel may differ by after the light is taken out, levels.
_PROVEN_LEVELS: Final = 3.0
_NOISE_PX: Final = 5
# A smaller change is left: scores under the light of the fit are those of the fit, bit for bit.
_LEAST_CHANGE: Final = 0.06
# A larger one is another light, or a fault of it, which a person is to see.
_MOST_GAIN: Final = 1.5

U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class FollowedLight:
    """How a press is brought to the light of the fit: level = gain * level + offset, of red, green and blue."""

    gain: tuple[float, float, float]
    offset: tuple[float, float, float]

    def restore(self, rgb: U8) -> U8:
        """Return a picture, uint8 (h, w, 3), under the light of the fit."""
        levels = np.arange(256)[:, None] * np.array(self.gain) + np.array(self.offset)
        table = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(rgb, table[None]), np.uint8)

    def undo(self, view: View) -> View:
        """Return a view under the light of the fit, float32 (h, w, 3), as it is under the light of now."""
        return np.asarray((view - np.array(self.offset)) / np.array(self.gain), np.float32)


def find_light(now: View | None, at_fit: View | None) -> tuple[FollowedLight | None, bool]:
    """Find what brings the free gel of now to that of the fit, float32 (h, w, 3) each; None where it need not be
    followed, or may not. Return also whether light alone has changed, if anything."""
    if now is None or at_fit is None or now.shape != at_fit.shape:
        return None, False
    levels = fit_levels(now, at_fit)
    lit = levels.applied(now)
    change = np.abs(lit.mean(axis=(0, 1)) / np.maximum(now.mean(axis=(0, 1)), 1) - 1)
    far = np.abs(cv2.blur(lit - at_fit, (_NOISE_PX, _NOISE_PX))).max(axis=2)
    is_usual = bool((levels.gain <= _MOST_GAIN).all() and (levels.gain >= 1 / _MOST_GAIN).all())
    is_proven = is_usual and float(np.quantile(far, 0.9)) <= _PROVEN_LEVELS
    if not is_proven or change.max() < _LEAST_CHANGE:
        return None, is_proven
    red, green, blue = (float(one) for one in levels.gain)
    offset = tuple(float(one) for one in levels.offset)
    return FollowedLight((red, green, blue), offset), True  # type: ignore[arg-type]
