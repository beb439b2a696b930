"""What a still of the overview camera showed before a press, and where in it the part is."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["PRESENT_SHARE", "Code", "CodeKind", "OverviewView", "TagFamily", "Zone"]

CodeKind = Literal["qr", "apriltag", "datamatrix"]
TagFamily = Literal["36h11", "36h10", "25h9", "16h5"]

# A part changes at least this share of the region.
PRESENT_SHARE: Final = 0.02


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


@dataclass(frozen=True)
class Code:
    """One code that was read."""

    kind: CodeKind
    text: str
    """The text of a QR code or DataMatrix, printable, or the number of an AprilTag."""


@dataclass(frozen=True)
class OverviewView:
    """One look before a press."""

    jpeg: bytes | None
    """The still, or None where there was none."""
    fault: str | None = None
    """Why there is no still."""
    changed: float | None = None
    """The share of the region that differs from the empty station, None where no picture of it is configured."""
    is_present: bool | None = None
    """Whether a part is there, None where nothing says so."""
    codes: tuple[Code, ...] = ()
    """The codes that were read in the region."""
    piece_ids: tuple[str, ...] = ()
    """The ids of pieces in these codes, each once."""

    def __post_init__(self) -> None:
        if (self.jpeg is None) == (self.fault is None):
            raise ValueError("a look has a still, or a fault that says why not")
