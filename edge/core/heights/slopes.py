"""Slopes from colours: at each pixel those whose colours fit best, by Gauss-Newton steps."""

import numpy as np
from numpy.typing import NDArray

from edge.core.heights.calibration import HeightCalibration

__all__ = ["SlopeFinder"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_STEPS = 3
# A step of a normal's part, and the steepest normal: 67 degrees, beyond any ball that was pressed.
_MOST_STEP, _STEEPEST = np.float32(0.3), np.float32(0.92)


class SlopeFinder:
    """Finds slopes of one part of the picture. powers: `place_powers` of it. light: the free gel's brightness."""

    def __init__(self, calibration: HeightCalibration, powers: F64, light: F64) -> None:
        # Colours are weighed by what the fit left of them; whitened, least squares needs no weights.
        white = np.linalg.cholesky(np.linalg.inv(calibration.rest)).T
        response = calibration.response * light[:, None, None]
        self._per_term = np.tensordot(np.tensordot(white, response, 1), powers, 1).astype(np.float32)
        self._white = white.astype(np.float32)
        self._nx = self._ny = np.zeros(powers.shape[1:], np.float32)

    def find(self, change: F32, raised_mm: F64) -> tuple[F64, F64]:
        """Return the slopes to the right and down, float64 (h, w) each; each call goes on from the last one.

        change: the press without the free gel, float32 (3, h, w). raised_mm: where the gel is by now thought to be.
        """
        term = self._per_term
        target = np.tensordot(self._white, change, 1) - term[:, 5] * raised_mm.astype(np.float32)
        nx, ny = self._nx, self._ny
        for _ in range(_STEPS):
            by_x = term[:, 0] + 2 * term[:, 2] * nx + term[:, 4] * ny
            by_y = term[:, 1] + 2 * term[:, 3] * ny + term[:, 4] * nx
            seen = (term[:, 0] + term[:, 2] * nx + term[:, 4] * ny) * nx + (term[:, 1] + term[:, 3] * ny) * ny
            rest = target - seen
            xx, xy, yy = (by_x * by_x).sum(0), (by_x * by_y).sum(0), (by_y * by_y).sum(0)
            x, y = (by_x * rest).sum(0), (by_y * rest).sum(0)
            # A determinant near 0 has no answer; the step is then held.
            inverse = 1 / np.maximum(xx * yy - xy * xy, np.float32(1e-6) * xx * yy + np.float32(1e-12))
            nx = nx + np.clip((yy * x - xy * y) * inverse, -_MOST_STEP, _MOST_STEP)
            ny = ny + np.clip((xx * y - xy * x) * inverse, -_MOST_STEP, _MOST_STEP)
            length = np.sqrt(nx * nx + ny * ny)
            held = _STEEPEST / np.maximum(length, _STEEPEST)
            nx, ny = nx * held, ny * held
        self._nx, self._ny = nx, ny
        flat = -1 / np.sqrt(1 - nx * nx - ny * ny).astype(np.float64)
        return nx * flat, ny * flat
