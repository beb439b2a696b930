"""The nominal presses of a bundle as small pictures, by which people see what a press was compared with.

A press is shown beside the one that looks most like it around its highest score, or beside the mean of all where the
bank holds a mean; and the difference. No score depends on them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import cv2
import numpy as np

from edge.core.arrays import F32, U8

__all__ = ["MOST_PICTURES", "Compared", "NominalPictures"]

MOST_PICTURES: Final = 64
"""Of more presses these, evenly chosen."""

# The longest side in pixels, of presses and of a mean; a multiple of the blocks of a JPEG, or neighbours would mix.
_SIDE, _MEAN_SIDE, _BLOCK = 160, 320, 16
_QUALITY: Final = 90
# Around the highest score: what a score of the shipped trunks sees most of.
_AROUND_MM: Final = 1.0
_LONGEST_NAME: Final = 128


class Compared(NamedTuple):
    """A press beside what it was compared with; both float32 (h, w, 3) of its region, in the bank's pose."""

    nominal: F32
    """Levels."""
    difference: F32
    """The press minus it, signed levels."""
    name: str
    """Whose picture it is."""


@dataclass(frozen=True)
class NominalPictures:
    """Pictures in the bank's pose, marker dots filled, as one file."""

    jpeg: bytes
    """One below the other."""
    size: tuple[int, int]
    """(width, height) of each."""
    names: tuple[str, ...]
    """The press of each, or of what it is the mean."""

    @classmethod
    def of(cls, frames: U8, names: Sequence[str], *, is_mean: bool) -> Self:
        """Make them of nominal presses, uint8 (n, h, w, 3), or of their mean."""
        if is_mean:
            names, pictures = [f"the mean of {len(frames)} nominal presses"], [frames.mean(axis=0)]
        else:
            chosen = np.unique(np.linspace(0, len(frames) - 1, MOST_PICTURES).round().astype(int))
            names, pictures = [f"nominal press {names[k]}" for k in chosen], [frames[k] for k in chosen]
        h, w = frames.shape[1:3]
        scale = min(1.0, (_MEAN_SIDE if is_mean else _SIDE) / max(h, w))
        size = _whole_blocks(w * scale), _whole_blocks(h * scale)
        strip = np.concatenate([_resize(np.asarray(picture, np.float32), size) for picture in pictures])
        bgr = np.clip(np.rint(strip[..., ::-1]), 0, 255).astype(np.uint8)
        jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        return cls(jpeg, size, tuple(name[:_LONGEST_NAME] for name in names))

    def compare(self, rgb: U8, peak: tuple[float, float], mm_per_pixel: tuple[float, float]) -> Compared:
        """Compare a press, uint8 (h, w, 3) as the pictures are. peak: (x, y) of the highest score, pixels of it."""
        (w, h), (width, height) = self.size, (rgb.shape[1], rgb.shape[0])
        bgr = np.asarray(cv2.imdecode(np.frombuffer(self.jpeg, np.uint8), cv2.IMREAD_COLOR))
        pictures = bgr[..., ::-1].reshape(-1, h, w, 3)
        press = _resize(rgb.astype(np.float32), self.size)
        across = (np.arange(w) - (peak[0] + 0.5) * w / width + 0.5) * mm_per_pixel[0] * width / w
        down = (np.arange(h)[:, None] - (peak[1] + 0.5) * h / height + 0.5) * mm_per_pixel[1] * height / h
        away = np.hypot(across, down)
        near = away <= max(_AROUND_MM, float(away.min()))
        around = pictures[:, near].astype(np.float32)  # of all the rest one is needed
        chosen = int(np.square(around - press[near]).sum(axis=(1, 2)).argmin())
        nominal = pictures[chosen].astype(np.float32)
        return Compared(
            _resize(nominal, (width, height)), _resize(press - nominal, (width, height)), self.names[chosen]
        )


def _whole_blocks(side: float) -> int:
    return max(1, round(side / _BLOCK)) * _BLOCK


def _resize(picture: F32, size: tuple[int, int]) -> F32:
    how = cv2.INTER_AREA if size[0] < picture.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size, interpolation=how), np.float32)
