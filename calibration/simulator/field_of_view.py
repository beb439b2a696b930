"""The field of view: which point of the gel, in millimetres, each pixel sees.

Origin: the centre of the crop that the maker's software cuts out of the camera's frame. x grows to the right and y
downwards, as in the picture. Heights grow from the gel's free surface towards the camera.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from edge.core.arrays import F32
from edge.core.imaging.known_profiles import MINI_BORDER, MINI_LR_MM_PER_PX, MINI_NATIVE

__all__ = ["CROP_MM", "HR", "LR", "Field", "grids", "native_field", "unit_grids"]

# The gel that the maker's crop shows, (x, y): 320x240 pixels.
CROP_MM = (320 * MINI_LR_MM_PER_PX, 240 * MINI_LR_MM_PER_PX)


@dataclass(frozen=True)
class Field:
    """A grid of pixels over the gel."""

    size: tuple[int, int]
    """(width, height) in pixels."""
    mm_per_px: tuple[float, float]
    """(x, y)."""
    centre_mm: tuple[float, float] = (0.0, 0.0)
    """(x, y) of its centre."""

    def __post_init__(self) -> None:
        if min(self.size) < 8:
            raise ValueError(f"a field has at least 8 pixels each way, found {self.size}")
        if min(self.mm_per_px) <= 0:
            raise ValueError(f"mm per pixel is positive, found {self.mm_per_px}")

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of an array over this field."""
        return (self.size[1], self.size[0])

    @property
    def extent_mm(self) -> tuple[float, float]:
        """The width and height of the field, (x, y)."""
        return (self.size[0] * self.mm_per_px[0], self.size[1] * self.mm_per_px[1])


LR = Field((320, 240), (MINI_LR_MM_PER_PX, MINI_LR_MM_PER_PX))
# The 16:9 picture shows the same 4:3 area of gel: a circle becomes an ellipse, as in the published dataset.
HR = Field((1280, 720), (CROP_MM[0] / 1280, CROP_MM[1] / 720))


def native_field(reduction: int = 4) -> Field:
    """The camera's complete frame, gel rim included, at 1/reduction of its resolution.

    A gateway decodes the frame at that reduction, so finer rendering would be lost.
    """
    if reduction not in (1, 2, 4, 8):
        raise ValueError(f"a reduction is 1, 2, 4 or 8, found {reduction}")
    width, height = MINI_NATIVE[0] // reduction, MINI_NATIVE[1] // reduction
    seen_x, seen_y = (1 - 2 * border for border in MINI_BORDER)
    return Field((width, height), (CROP_MM[0] / seen_x / width, CROP_MM[1] / seen_y / height))


@lru_cache(maxsize=8)
def grids(field: Field) -> tuple[F32, F32]:
    """x and y in mm at the pixel centres, float32 (h, w) each, read-only."""
    x, y = (
        (np.arange(n, dtype=np.float32) + np.float32(0.5 - n / 2)) * np.float32(mm) + np.float32(centre)
        for n, mm, centre in zip(field.size, field.mm_per_px, field.centre_mm, strict=True)
    )
    xx, yy = np.meshgrid(x, y)
    xx.setflags(write=False)
    yy.setflags(write=False)
    return xx, yy


@lru_cache(maxsize=8)
def unit_grids(field: Field) -> tuple[F32, F32]:
    """u and v, which run from -1 to 1 over the crop and are held at its edge outside it (float32, read-only)."""
    x, y = grids(field)
    limit = np.float32(1.02)
    u = np.clip(x / np.float32(CROP_MM[0] / 2), -limit, limit)
    v = np.clip(y / np.float32(CROP_MM[1] / 2), -limit, limit)
    u.setflags(write=False)
    v.setflags(write=False)
    return u, v
