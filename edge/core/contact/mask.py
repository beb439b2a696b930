"""Where a view is touched: the signed difference to the reference, thresholded and cleaned by morphology."""

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.reference import View

__all__ = [
    "BLACK_LEVEL",
    "Touch",
    "imprint_strength",
    "is_black",
    "largest_colour",
    "mask_beyond",
    "measure_change",
    "squared_distance",
    "touched",
    "touched_mask",
]

# Colour distance in levels, Euclidean over RGB. gs_sdk, GelSLAM and NormalFlow use 15; noise stays below 6.
TOUCH_LEVELS = 15.0
# Closing fills the stripes between thread crests, opening drops specks and noise. 5 px of the 160x120 view are 10 px
# at 320x240, near the 7 and 15 of gs_sdk's dilation and erosion.
MORPHOLOGY_SIDE = 5
# A change in one pixel between two views, levels; noise moves none this far. With a fifth of the touched pixels allowed
# it takes even a shearing fingertip's pauses for still (the maker's press video), and no approach.
CHANGE_LEVELS = 12.0

# A pixel adds nothing to the strength of an imprint up to this distance, and all of it from the threshold on. It is
# taken over a neighbourhood.
_FAINT_LEVELS = 10.0
_SMOOTH = (3, 3)

# Adds the colours of a pixel.
_SUM = np.ones((1, 3), np.float32)

Level = TypeVar("Level", np.uint8, np.float32)

BLACK_LEVEL = 8.0
"""Below this mean level the LEDs or the camera are off, or not ready: real backgrounds have means of 78 to 168."""


@dataclass(frozen=True)
class Touch:
    """The touched area. x, y: centroid as fractions of width and height, 0.5 if none."""

    area: float
    """Fraction of the view."""
    x: float = 0.5
    y: float = 0.5

    def __post_init__(self) -> None:
        if not (0 <= self.area <= 1 and 0 <= self.x <= 1 and 0 <= self.y <= 1):
            raise ValueError(f"area and centroid are fractions of the view, found {self}")


def touched_mask(difference: View) -> NDArray[np.bool_]:
    """True where the gel is touched: bool (h, w). difference: signed float32 (h, w, 3), levels.

    Holes are filled: a part that is flat on the gel, like a ball's pole, bends no light and shows only at its edge.
    """
    return mask_beyond(squared_distance(difference))


def squared_distance(difference: View) -> NDArray[np.float32]:
    """The squared colour distance of each pixel: float32 (h, w), levels squared."""
    return np.asarray(cv2.transform(cv2.multiply(difference, difference), _SUM), np.float32)


def largest_colour(picture: NDArray[Level]) -> NDArray[Level]:
    """Return the largest of the three colours of each pixel, (h, w). picture: (h, w, 3). NumPy's own loop over three
    numbers takes ten times as long."""
    red, green, blue = (picture[..., k] for k in range(3))
    return np.maximum(np.maximum(red, green), blue)


def mask_beyond(squared: NDArray[np.float32]) -> NDArray[np.bool_]:
    """`touched_mask` from squared colour distances, float32 (h, w)."""
    far = (squared > TOUCH_LEVELS**2).astype(np.uint8)
    kernel = np.ones((MORPHOLOGY_SIDE, MORPHOLOGY_SIDE), np.uint8)
    closed = cv2.morphologyEx(far, cv2.MORPH_CLOSE, kernel)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, kernel)
    outlines, _ = cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(opened, outlines, -1, 1, cv2.FILLED), dtype=np.bool_)


def touched(mask: NDArray[np.bool_]) -> Touch:
    """Area and centroid of a mask."""
    sums = cv2.moments(mask.astype(np.uint8), binaryImage=True)
    if not sums["m00"]:
        return Touch(0.0)
    height, width = mask.shape
    return Touch(
        area=sums["m00"] / mask.size,
        x=(sums["m10"] / sums["m00"] + 0.5) / width,
        y=(sums["m01"] / sums["m00"] + 0.5) / height,
    )


def measure_change(view: View, earlier: View) -> float:
    """The share of pixels where any channel differs by more than the noise does."""
    bound = (CHANGE_LEVELS, CHANGE_LEVELS, CHANGE_LEVELS, CHANGE_LEVELS)
    same = cv2.inRange(cv2.absdiff(view, earlier), (0.0, 0.0, 0.0, 0.0), bound)
    return 1.0 - cv2.countNonZero(same) / same.size


def imprint_strength(squared: NDArray[np.float32]) -> float:
    """How much an imprint differs from the free gel, averaged over the view, levels; it grows with depth.

    squared: `squared_distance`, float32 (h, w). A pixel counts by how far it is beyond the threshold, after noise is
    averaged out: what is in a mask or not would move the strength of a part at rest by a twentieth.
    """
    distance = cv2.sqrt(cv2.blur(squared, _SMOOTH))
    weight = np.clip((distance - _FAINT_LEVELS) / (TOUCH_LEVELS - _FAINT_LEVELS), 0, 1)
    return float((distance * weight).mean())


def is_black(view: View) -> bool:
    """True for the black frames with which a camera starts."""
    return float(view.mean()) < BLACK_LEVEL
