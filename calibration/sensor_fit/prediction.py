"""What the simulator predicts for one press of a ball, linear in the sensor's response, in a window around the press.

The same steps as `Renderer.light` (gel, slopes, lights, shadows, gloss, lens), over a part of the picture: a fit
predicts thousands of presses.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration.sensor_fit.ball import Ball, ball_height
from calibration.simulator import camera, optics
from calibration.simulator.field_of_view import F32, LR, Field, grids
from calibration.simulator.gel import Gel, deformation
from calibration.simulator.sensor_appearance import place_powers

__all__ = ["COLUMNS", "CONSTANT_COLUMNS", "Prediction", "Window", "predict", "window_around"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

COLUMNS = 21
"""Of a response: six of nx, six of ny, three squares, six of the height."""
CONSTANT_COLUMNS = (0, 6, 12, 13, 14, 15)
"""Those that do not change from place to place."""
# The gel lifts this far around a contact, as a share of its radius and in mm.
_LIFTED, _LIFTED_MM, _SPARE_MM = 1.5, 0.3, 0.9


@dataclass(frozen=True)
class Window:
    """A square of pixels that may reach beyond the picture."""

    x: int
    y: int
    """Its first column and row."""
    side: int
    """The side in pixels."""

    @property
    def field(self) -> Field:
        return Field((self.side, self.side), LR.mm_per_px)

    @cached_property
    def seen(self) -> tuple[slice, slice]:
        """Its part of the picture."""
        width, height = LR.size
        return slice(max(self.y, 0), min(self.y + self.side, height)), slice(
            max(self.x, 0), min(self.x + self.side, width)
        )

    @property
    def inner(self) -> tuple[slice, slice]:
        """This part, counted in the window."""
        rows, columns = self.seen
        return slice(rows.start - self.y, rows.stop - self.y), slice(
            columns.start - self.x, columns.stop - self.x
        )

    def places(self) -> tuple[F32, F32]:
        """x and y of its pixels in mm from the picture's centre, float32 (side, side)."""
        x, y = grids(self.field)
        mm, (width, height) = LR.mm_per_px[0], LR.size
        shift = (self.x + (self.side - width) / 2) * mm, (self.y + (self.side - height) / 2) * mm
        return x + np.float32(shift[0]), y + np.float32(shift[1])


def window_around(ball: Ball, contact_mm: float) -> Window:
    """A window that holds everything a press changes, and some free gel."""
    mm = LR.mm_per_px[0]
    half = math.ceil((_LIFTED * contact_mm + _LIFTED_MM + _SPARE_MM) / mm)
    column, row = round(ball.x_mm / mm + LR.size[0] / 2), round(ball.y_mm / mm + LR.size[1] / 2)
    return Window(column - half, row - half, 2 * half)


@dataclass(frozen=True, eq=False)
class Prediction:
    """A press in its window, before the response is known."""

    columns: F32
    """float32 (COLUMNS, rows, cols)."""
    kept: F32
    """float32 (3, rows, cols), the light that shadows leave."""
    offset: F32
    """float32 (3, rows, cols), the change that does not depend on the response."""
    height_mm: F32
    """The height of the ball above the free gel."""
    changed: Mask
    """bool (rows, cols), where the gel is lifted."""

    def change(self, response: F64) -> F32:
        """The press without the free gel, float32 (3, rows, cols). response: float64 (3, COLUMNS)."""
        linear = np.tensordot(response.astype(np.float32), self.columns, axes=1)
        return np.asarray(linear * self.kept + self.offset, np.float32)


def predict(ball: Ball, ball_radius_mm: float, gel: Gel, free: F32, window: Window) -> Prediction:
    """free: the free gel of the whole picture, float32 (3, 240, 320)."""
    x, y = window.places()
    height = ball_height(ball, ball_radius_mm, x, y)
    surface = deformation(height, window.field, gel)
    nx, ny = (part[window.inner] for part in optics.normals(surface, window.field))
    lens = camera.lens_falloff(LR)[window.seen]
    planes = np.zeros((3, *lens.shape), np.float32)
    gloss = optics.specular(planes, nx, ny) * lens
    kept = optics.shadows(np.ones((3, *window.field.shape), np.float32), surface, window.field)
    kept = camera.lens_blur(np.ascontiguousarray(kept[:, *window.inner]), LR)
    here = np.ascontiguousarray(free[:, *window.seen])
    reach = _LIFTED * ball.contact_radius_mm(ball_radius_mm) + _LIFTED_MM
    inner = window.inner
    return Prediction(
        _columns(nx, ny, surface[inner], lens, window.seen),
        kept,
        (here + camera.lens_blur(gloss, LR)) * kept - here,
        height[inner],
        np.asarray(np.hypot(x - ball.x_mm, y - ball.y_mm)[inner] < reach),
    )


def _columns(nx: F32, ny: F32, surface: F32, lens: F32, seen: tuple[slice, slice]) -> F32:
    """Return the columns in the order of `slope_response` and `height_response`, through the lens."""
    powers = _powers()[:, *seen]
    squares = np.stack([nx * nx, ny * ny, nx * ny]) * lens
    columns = np.concatenate([nx * powers, ny * powers, squares, surface * powers])
    return camera.lens_blur(np.ascontiguousarray(columns, dtype=np.float32), LR)


@lru_cache(maxsize=1)
def _powers() -> F32:
    return np.asarray(place_powers(LR), np.float32)
