"""Light that has changed since the fit, and the shading of a new gel: followed where the free gel proves it.

The free gel of now is brought to that of the fit by one gain and one offset for each colour. Where nothing else remains
it is the same gel under another light, and a press is brought to the light of the fit in the same way. A lamp that
fails on one side leaves more: then nothing is changed, and what is charted says so.

Another gel has a shading of its own. Where one was mounted, its first picture tells by how much it is lighter or darker
than the gel of the fit, in every colour and at every place; what of that varies over some millimetres is added to each
press. A mark or a cut of the gel is smaller, and stays. Another kind of sensor is not followed.

Ref: measured on simulated gels, in levels of nine tenths of the 160x120 view: 0.8 to 1.1 after a lamp with 80 to 110 %
of its light, all colours or one; 5.4 where it falls by a tenth on one side; 11 to 13 between two units. Noise of single
pixels is taken out first.
"""

import base64
from dataclasses import dataclass, field, replace
from typing import Final

import cv2
import numpy as np

from edge.core.arrays import U8
from edge.core.contact.mask import largest_colour
from edge.core.contact.reference import View, fit_levels
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_check import is_same_kind

__all__ = ["FollowedLight", "find_light"]

# What nine tenths of the free gel may differ by after the light is taken out, levels.
_PROVEN_LEVELS: Final = 3.0
_NOISE_PX: Final = 5
# A smaller change is left: scores under the light of the fit are those of the fit, bit for bit.
_LEAST_CHANGE: Final = 0.06
# A larger one is another light, or a fault of it, which a person is to see.
_MOST_GAIN: Final = 1.5

# The shading of a gel: cells of a picture, a half level a step; its smoothing, as a share of the width, 0.7 mm of 19.
_CELLS: Final = (15, 20)
_STEP: Final = 0.5
_SMOOTH_SHARE: Final = 0.0375
_SAME, _NOTHING = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)

_Colour = tuple[float, float, float]


@dataclass(frozen=True)
class FollowedLight:
    """How a press is brought to the light and the gel of the fit: gain * level + offset + shading, of red, green and
    blue."""

    gain: _Colour
    offset: _Colour
    shading: str = field(default="", repr=False)
    """By how much the gel of the fit is lighter than a new one, over the whole picture: int8 (15, 20, 3), half levels,
    in base64; empty for the gel of the fit."""

    def record(self) -> tuple[_Colour, _Colour] | tuple[_Colour, _Colour, str]:
        """Return what makes it again, as short as it may be."""
        return (self.gain, self.offset, self.shading) if self.shading else (self.gain, self.offset)

    def restore(self, rgb: U8, region: Region | None = None, size: tuple[int, int] | None = None) -> U8:
        """Return a picture, uint8 (h, w, 3), under the light of the fit. region: the part of the camera's picture, of
        this size (width, height), that it shows; by default all."""
        if self.shading:
            spread = self.spread(size or (rgb.shape[1], rgb.shape[0]))
            added = spread if region is None else region.crop(spread)
            levels = rgb * np.array(self.gain, np.float32) + np.array(self.offset, np.float32) + added
            return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)
        levels = np.arange(256)[:, None] * np.array(self.gain) + np.array(self.offset)
        table = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(rgb, table[None]), np.uint8)

    def undo(self, view: View) -> View:
        """Return a view of the gel of the fit, float32 (h, w, 3), as the gel of now is under the light of now."""
        added = self.spread((view.shape[1], view.shape[0])) if self.shading else 0.0
        return np.asarray((view - added - np.array(self.offset)) / np.array(self.gain), np.float32)

    def spread(self, size: tuple[int, int]) -> View:
        """Return the shading over a picture of this size (width, height), levels, float32 (h, w, 3)."""
        cells = (
            np.frombuffer(base64.b64decode(self.shading), np.int8).reshape(*_CELLS, 3).astype(np.float32)
            * _STEP
        )
        return np.asarray(cv2.resize(cells, size, interpolation=cv2.INTER_LINEAR), np.float32)


def find_light(
    now: View | None, at_fit: View | None, new_gel: View | None = None
) -> tuple[FollowedLight | None, bool]:
    """Find what brings the free gel of now to that of the fit, float32 (h, w, 3) each; None where it need not be
    followed, or may not. new_gel: the first picture of a gel that was mounted in place of an earlier one: its shading
    is followed, and the light of now is compared with that of this picture. Return also whether light alone has
    changed, if anything."""
    if now is None or at_fit is None or now.shape != at_fit.shape:
        return None, False
    light, is_proven = _find_levels(now, at_fit)
    if is_proven or new_gel is None or new_gel.shape != at_fit.shape:
        return light, is_proven
    shading = _shade(at_fit - new_gel)
    shaded = new_gel + FollowedLight(_SAME, _NOTHING, shading).spread((at_fit.shape[1], at_fit.shape[0]))
    if not is_same_kind(new_gel, at_fit) or _differ(shaded, at_fit) > _PROVEN_LEVELS:
        return None, False
    light, is_proven = _find_levels(now, new_gel)
    return replace(light or FollowedLight(_SAME, _NOTHING), shading=shading), is_proven


def _find_levels(now: View, known: View) -> tuple[FollowedLight | None, bool]:
    """Find what brings a view to the light of another one of the same gel, as `find_light` does."""
    levels = fit_levels(now, known)
    lit = levels.applied(now)
    change = np.abs(lit.mean(axis=(0, 1)) / np.maximum(now.mean(axis=(0, 1)), 1) - 1)
    is_usual = bool((levels.gain <= _MOST_GAIN).all() and (levels.gain >= 1 / _MOST_GAIN).all())
    is_proven = is_usual and _differ(lit, known) <= _PROVEN_LEVELS
    if not is_proven or change.max() < _LEAST_CHANGE:
        return None, is_proven
    red, green, blue = (float(one) for one in levels.gain)
    offset = tuple(float(one) for one in levels.offset)
    return FollowedLight((red, green, blue), offset), True  # type: ignore[arg-type]


def _differ(one: View, other: View) -> float:
    """Measure by how much nine tenths of two views differ at most, without the noise of single pixels, levels."""
    far = largest_colour(np.abs(cv2.blur(one - other, (_NOISE_PX, _NOISE_PX))))
    return float(np.quantile(far, 0.9))


def _shade(difference: View) -> str:
    """Keep what varies slowly of a difference of two views, float32 (h, w, 3)."""
    smooth = cv2.GaussianBlur(difference, (0, 0), _SMOOTH_SHARE * difference.shape[1])
    cells = cv2.resize(smooth, _CELLS[::-1], interpolation=cv2.INTER_AREA)
    return base64.b64encode(np.clip(np.rint(cells / _STEP), -127, 127).astype(np.int8)).decode()
