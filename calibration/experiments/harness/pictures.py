"""The pictures that a study shows to a trunk: which presses, in which view, and a hash of all of it."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset import SIZES, LabelledPress
from calibration.fitting.trunks import Trunk
from edge.core.arrays import U8, Mask
from edge.core.errors import DatasetError
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.core.imaging.region import Region
from edge.core.imaging.tiles import Tiles

__all__ = ["LR_VIEW", "PressPictures", "View", "find_centre", "tile"]


@dataclass(frozen=True)
class View:
    """How a press is shown: pictures of `size`, scaled to `scaled_to` if that is given, cut to the region.

    size, scaled_to: (width, height).
    """

    size: tuple[int, int]
    region: Region
    pixels_per_mm: float
    """The scale of the picture that the trunk sees."""
    scaled_to: tuple[int, int] | None = None
    is_tiled: bool = field(default=False, repr=False)
    """Whether the trunk sees it in the paper's tiles, of 224 with 56 pixels in common; not part of the hash."""

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w) of the region."""
        return self.region.height, self.region.width

    def rgb(self, press: LabelledPress) -> U8:
        """uint8 (h, w, 3). Errors: DatasetError for a broken file, or one of another size."""
        if press.size != self.size:
            raise DatasetError(
                f"'{press.path}' is {press.size[0]}x{press.size[1]}, the study looks at {self.size[0]}x{self.size[1]}; "
                "give pictures of one size"
            )
        picture = press.rgb()
        if self.scaled_to is not None:
            picture = np.asarray(
                cv2.resize(picture, self.scaled_to, interpolation=cv2.INTER_LINEAR), np.uint8
            )
        return np.ascontiguousarray(self.region.crop(picture))

    def mask(self, press: LabelledPress) -> Mask:
        """bool (h, w). Errors: DatasetError for a broken file."""
        mask = press.mask()
        if self.scaled_to is not None:
            larger = cv2.resize(mask.astype(np.uint8), self.scaled_to, interpolation=cv2.INTER_NEAREST)
            mask = np.asarray(larger, np.bool_)
        return np.ascontiguousarray(self.region.crop(mask))


LR_VIEW = View(SIZES["lr"], Region.centre(SIZES["lr"]), LR_PIXELS_PER_MM)
"""The paper's low resolution: the central 224x224 of 320x240."""


def find_centre(size: tuple[int, int]) -> Region:
    """Return what `LR_VIEW` shows of the gel, in pixels of a picture of another size."""
    across, down = size[0] // LR_VIEW.size[0], size[1] // LR_VIEW.size[1]
    low = LR_VIEW.region
    return Region(low.x * across, low.y * down, low.width * across, low.height * down)


def tile(trunk: Trunk, layout: Tiles) -> Trunk:
    """Return a trunk that sees a picture in tiles. Errors: ConfigError for a trunk that cannot be tiled."""
    from plugins.backbones.tiled import tile_trunk

    return replace(trunk, graph=tile_trunk(trunk.graph, layout))


@dataclass(frozen=True)
class PressPictures:
    """The pictures of presses in one view, read when they are needed."""

    presses: tuple[LabelledPress, ...]
    view: View

    def __len__(self) -> int:
        return len(self.presses)

    def read(self, start: int, stop: int) -> U8:
        """uint8 (stop - start, h, w, 3). Errors: DatasetError."""
        return np.stack([self.view.rgb(press) for press in self.presses[start:stop]])

    def masks(self, rows: Sequence[int] | NDArray[np.int64]) -> Mask:
        """bool (len(rows), h, w), all False for a nominal press. Errors: DatasetError."""
        return np.stack([self.view.mask(self.presses[row]) for row in rows])

    @cached_property
    def sha256(self) -> str:
        """The hash of the files' bytes in order, and of the view."""
        return hashlib.sha256(b"".join((repr(self.view).encode(), *self.digests))).hexdigest()

    @cached_property
    def digests(self) -> tuple[bytes, ...]:
        """SHA-256 of each file. Errors: DatasetError."""
        return tuple(_digest(press) for press in self.presses)


def _digest(press: LabelledPress) -> bytes:
    try:
        return hashlib.sha256(press.path.read_bytes()).digest()
    except OSError as error:
        raise DatasetError(f"'{press.path}' cannot be read: {error.strerror}") from error
