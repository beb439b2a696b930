"""Whether a part is there: how much of a still differs from a picture of the empty station."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Zone", "share_of_change"]

# Both pictures are compared at about this width: a part that matters is larger than 1/160 of the view.
COMPARED_PX: Final = 160
# A difference above the noise of a webcam's blurred picture and its JPEG.
LEVELS: Final = 20.0


@dataclass(frozen=True)
class Zone:
    """A part of a picture in fractions of its width and height."""

    left: float = 0.0
    top: float = 0.0
    width: float = 1.0
    height: float = 1.0

    def __post_init__(self) -> None:
        sides = ((self.left, self.width), (self.top, self.height))
        if not all(0 <= start < 1 and 0 < length <= 1 - start + 1e-9 for start, length in sides):
            raise ValueError(
                "a region is left, top, width, height in fractions of the picture and lies in it, found "
                f"{self.left:g}, {self.top:g}, {self.width:g}, {self.height:g}"
            )

    def of(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """This part of a picture, at least one pixel. grey: uint8 (h, w)."""
        rows = _span(grey.shape[0], self.top, self.height)
        return grey[rows, _span(grey.shape[1], self.left, self.width)]


def _span(pixels: int, start: float, length: float) -> slice:
    """Cut a span of at least one pixel."""
    first = min(int(start * pixels), pixels - 1)
    return slice(first, max(first + 1, round((start + length) * pixels)))


def share_of_change(grey: NDArray[np.uint8], empty: NDArray[np.uint8]) -> float:
    """Measure the share of pixels that differ from the empty station. Both uint8 (h, w); their sizes may differ.

    A change of the light of the entire view is taken out: it is the median of the differences.
    """
    h, w = empty.shape
    size = (min(w, COMPARED_PX), max(1, round(h * min(w, COMPARED_PX) / w)))
    difference = _small(grey, size) - _small(empty, size)
    return float((np.abs(difference - np.median(difference)) > LEVELS).mean())


def _small(grey: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.float32]:
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return cv2.GaussianBlur(small, (0, 0), 1.0).astype(np.float32)
