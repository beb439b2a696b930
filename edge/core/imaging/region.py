"""Regions: the part of the picture that a detector inspects, and the touched area seen in it."""

import re
from dataclasses import dataclass
from typing import Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError

__all__ = ["CENTRE_SIDE", "Region", "touched_in"]

# The seed paper crops its 320x240 pictures to the central 224x224, the input side of its backbone.
CENTRE_SIDE = 224

_NUMBERS = re.compile(r"\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*[x,]\s*(\d+)\s*")

_Scalar = TypeVar("_Scalar", bound=np.generic)


@dataclass(frozen=True)
class Region:
    """A rectangle in picture pixels: left column x, top row y, width and height."""

    x: int
    y: int
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.x < 0 or self.y < 0 or self.width < 1 or self.height < 1:
            raise ValueError(f"a region has x, y >= 0 and width, height >= 1, found {self}")

    @classmethod
    def centre(cls, size: tuple[int, int]) -> Self:
        """The central square of a picture of size (width, height)."""
        side = CENTRE_SIDE
        x, y = (size[0] - side) // 2, (size[1] - side) // 2
        if min(x, y) < 0:
            raise ConfigError(
                f"a centre region of {side}x{side} does not fit a picture of {_size_text(size)}"
            )
        return cls(x, y, side, side)

    @classmethod
    def full(cls, size: tuple[int, int]) -> Self:
        """The complete picture of size (width, height)."""
        return cls(0, 0, *size)

    @classmethod
    def parse(cls, text: str, size: tuple[int, int]) -> Self:
        """A region from its text in the configuration: `centre`, `full`, or `x,y,WIDTHxHEIGHT` such as `48,8,224x224`.

        size: (width, height) of the picture. Errors: ConfigError for another text or a region outside the picture.
        """
        match text.strip().lower():
            case "centre" | "center":
                return cls.centre(size)
            case "full":
                return cls.full(size)
        numbers = _NUMBERS.fullmatch(text)
        if numbers is None:
            raise ConfigError(
                f"region '{text}' is not understood; "
                "write 'centre', 'full' or 'x,y,WIDTHxHEIGHT' such as '48,8,224x224'"
            )
        x, y, width, height = map(int, numbers.groups())
        if width < 1 or height < 1:
            raise ConfigError(f"region '{text}' is empty; width and height are at least 1")
        region = cls(x, y, width, height)
        if not region.is_within(size):
            raise ConfigError(
                f"region '{text}' reaches ({x + width}, {y + height}), outside the picture of {_size_text(size)}; "
                "move or shrink it"
            )
        return region

    def is_within(self, size: tuple[int, int]) -> bool:
        """True where the region is completely inside a picture of size (width, height)."""
        return self.x + self.width <= size[0] and self.y + self.height <= size[1]

    def crop(self, pixels: NDArray[_Scalar]) -> NDArray[_Scalar]:
        """The region of an array (h, w) or (h, w, c), as a view. Errors: ValueError where it reaches outside."""
        size = (pixels.shape[1], pixels.shape[0])
        if not self.is_within(size):
            raise ValueError(f"region {self} reaches outside the picture of {_size_text(size)}")
        return pixels[self.y : self.y + self.height, self.x : self.x + self.width]

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width}x{self.height}"


def touched_in(mask: NDArray[np.bool_], size: tuple[int, int], region: Region) -> NDArray[np.bool_]:
    """The touched area of a contact view, seen in a region of the picture: bool (region.height, region.width).

    mask: bool (h, w) of the view. size: (width, height) of the picture. Nearest pixel, because a mask has no
    intermediate values.
    """
    pixels = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return region.crop(np.asarray(pixels, dtype=np.bool_))


def _size_text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
