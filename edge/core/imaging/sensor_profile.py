"""Sensor profiles: how a camera frame becomes the picture that a bundle was built on, and how the camera is set.

Three public crops of the same sensor differ (1/7 border, 0.15, none), and the camera has one video mode. So crop,
scale, kernel and colour order are fixed here and stored in the bundle.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["LONGEST_SIDE", "SensorProfile", "cut_in_words", "cut_to_aspect"]

LONGEST_SIDE = 8192
"""Pixels or cells of any picture: the longest side of the sensor's frames has 3280."""


@dataclass(frozen=True)
class SensorProfile:
    """Geometry and camera settings of one way of reading a sensor."""

    name: str
    native: tuple[int, int]
    """(width, height) of the camera's frames."""
    border: tuple[float, float]
    """Fraction cut from each side, (x, y)."""
    size: tuple[int, int]
    """(width, height) of the picture after area resampling."""
    decode_scale: int
    """1, 2, 4 or 8: the JPEG reduction. Its DCT resampler differs, so it is part of the profile."""
    pixels_per_mm: float
    """The scale of the picture along x."""
    controls: Mapping[str, int] = field(default_factory=dict)
    """Camera control name to value, V4L2 names."""

    @property
    def mm_per_pixel(self) -> tuple[float, float]:
        """(x, y) of the picture. They differ where the profile squeezes one axis, as mini_hr does."""
        along_x = 1 / self.pixels_per_mm
        cut_w, cut_h = (side * (1 - 2 * cut) for side, cut in zip(self.native, self.border, strict=True))
        return along_x, along_x * (cut_h / self.size[1]) / (cut_w / self.size[0])

    def __post_init__(self) -> None:
        if self.decode_scale not in (1, 2, 4, 8):
            raise ValueError(f"decode_scale is 1, 2, 4 or 8, found {self.decode_scale}")
        if not all(0 <= b < 0.5 for b in self.border):
            raise ValueError(f"fractions of the border are in [0, 0.5), found {self.border}")
        if min(*self.native, *self.size) < 1 or max(*self.native, *self.size) > LONGEST_SIDE:
            raise ValueError(
                f"sizes are 1 to {LONGEST_SIDE} pixels, found native {self.native} and size {self.size}"
            )
        if not self.pixels_per_mm > 0 or not 1 <= len(self.name) <= 128:
            raise ValueError(
                f"a profile has a name and a scale, found '{self.name:.128}', {self.pixels_per_mm}"
            )


def cut_to_aspect(size: tuple[int, int], wanted: tuple[int, int]) -> tuple[float, float]:
    """The fraction that is cut from each side, (x, y), so that (width, height) gets the aspect of `wanted`."""
    width, height = size
    aspect = wanted[0] / wanted[1]
    return (max(0.0, (1 - height * aspect / width) / 2), max(0.0, (1 - width / aspect / height) / 2))


def cut_in_words(size: tuple[int, int], wanted: tuple[int, int]) -> str:
    """Describe what happens to a picture of this size, such as `640x400 cut to 533x400 and scaled to 320x240`."""
    x, y = cut_to_aspect(size, wanted)
    left = (round(size[0] * (1 - 2 * x)), round(size[1] * (1 - 2 * y)))
    cut = "" if left == size else f" cut to {left[0]}x{left[1]} in the middle and"
    return f"{size[0]}x{size[1]}{cut} scaled to {wanted[0]}x{wanted[1]}"
