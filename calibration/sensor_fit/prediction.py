"""What the simulator predicts for one press of a ball, linear in the sensor's response, in a window around the press.

The same steps as `Renderer.light` (gel, slopes, lights, shadows, gloss, lens), over a part of the picture: a fit
predicts thousands of presses.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calibration.sensor_fit.ball import Ball, ball_height
from calibration.simulator import camera, optics
from calibration.simulator.field_of_view import LR, Field, grids
from calibration.simulator.gel import Gel, deformation
from calibration.simulator.sensor_appearance import place_powers
from edge.core.arrays import F32, F64, Mask

__all__ = ["COLUMNS", "CONSTANT_COLUMNS", "Prediction", "Window", "predict", "window_around"]

COLUMNS = 21
"""Of a response: six of nx, six of ny, three squares, six of the height."""
CONSTANT_COLUMNS = (0, 6, 12, 13, 14, 15)
"""Those that do not change from place to place."""
# The gel lifts this far around a contact, as a share of its radius and in mm.
_LIFTED, _LIFTED_MM, _SPARE_MM = 1.5, 0.3, 0.9

Window = tuple[slice, slice]
"""Rows and columns of the picture."""


def window_around(ball: Ball, contact_mm: float) -> Window:
    """Return the part of the picture that holds everything a press changes, and some free gel."""
    mm, (width, height) = LR.mm_per_px[0], LR.size
    half = math.ceil((_LIFTED * contact_mm + _LIFTED_MM + _SPARE_MM) / mm)
    column, row = round(ball.x_mm / mm + width / 2), round(ball.y_mm / mm + height / 2)
    return slice(max(row - half, 0), min(row + half, height)), slice(
        max(column - half, 0), min(column + half, width)
    )


def _field(window: Window) -> Field:
    """The view of a window: its pixels lie where the picture has them."""
    (top, bottom), (left, right) = ((part.start, part.stop) for part in window)
    mm, (width, height) = LR.mm_per_px[0], LR.size
    centre = ((left + right - width) / 2 * mm, (top + bottom - height) / 2 * mm)
    return Field((right - left, bottom - top), LR.mm_per_px, centre)


@dataclass(frozen=True, eq=False)
class Prediction:
    """A press in its window, before the response is known."""

    columns: F32
    """float32 (COLUMNS, rows, cols)."""
    kept: F32
    """float32 (3, rows, cols), the light that shadows leave."""
    offset: F32
    """float32 (3, rows, cols), the change that does not depend on the response."""
    changed: Mask
    """bool (rows, cols), where the gel is lifted."""

    def change(self, response: F64) -> F32:
        """The press without the free gel, float32 (3, rows, cols). response: float64 (3, COLUMNS)."""
        linear = np.tensordot(response.astype(np.float32), self.columns, axes=1)
        return np.asarray(linear * self.kept + self.offset, np.float32)


def predict(ball: Ball, ball_radius_mm: float, gel: Gel, free: F32, window: Window) -> Prediction:
    """free: the free gel of the whole picture, float32 (3, 240, 320)."""
    field = _field(window)
    x, y = grids(field)
    height = ball_height(ball, ball_radius_mm, x, y)
    surface = deformation(height, field, gel)
    nx, ny = optics.normals(surface, field)
    lens = camera.lens_falloff(LR)[window]
    gloss = optics.specular(np.zeros((3, *lens.shape), np.float32), nx, ny) * lens
    kept = optics.shadows(np.ones((3, *lens.shape), np.float32), surface, field)
    kept = camera.lens_blur(kept, LR)
    here = free[:, *window]
    reach = _LIFTED * ball.contact_radius_mm(ball_radius_mm) + _LIFTED_MM
    return Prediction(
        _columns(nx, ny, surface, lens, window),
        kept,
        (here + camera.lens_blur(gloss, LR)) * kept - here,
        np.asarray(np.hypot(x - ball.x_mm, y - ball.y_mm) < reach),
    )


def _columns(nx: F32, ny: F32, surface: F32, lens: F32, window: Window) -> F32:
    """Return the columns in the order of `slope_response` and `height_response`, through the lens."""
    powers = _powers()[:, *window]
    squares = np.stack([nx * nx, ny * ny, nx * ny]) * lens
    columns = np.concatenate([nx * powers, ny * powers, squares, surface * powers])
    return camera.lens_blur(np.ascontiguousarray(columns, dtype=np.float32), LR)


@lru_cache(maxsize=1)
def _powers() -> F32:
    return np.asarray(place_powers(LR), np.float32)
