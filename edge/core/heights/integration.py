"""Heights from slopes: the surface whose steps between neighbours fit best, by least squares."""

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["integrate"]

F64 = NDArray[np.float64]


def integrate(slope_x: F64, slope_y: F64, mm_per_px: tuple[float, float]) -> F64:
    """Return the heights, mm, mean 0, float64 (h, w). slope_x, slope_y: mm per mm to the right and down, (h, w) with
    even sides, which OpenCV's transform takes.

    A step between two pixels is the mean of their slopes, and nothing is asked beyond the border (Neumann). The cosine
    transform solves it exactly, with the eigenvalues of this very step: solvers that mix another derivative with them
    are wrong in scale by the size of the feature.
    """
    height, width = slope_x.shape
    across, down = np.zeros((2, height, width))
    across[:, :-1] = (slope_x[:, 1:] + slope_x[:, :-1]) * (mm_per_px[0] / 2)
    down[:-1] = (slope_y[1:] + slope_y[:-1]) * (mm_per_px[1] / 2)
    bend = across + down
    bend[:, 1:] -= across[:, :-1]
    bend[1:] -= down[:-1]
    rows, columns = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in (height, width))
    eigenvalues = rows[:, None] + columns
    eigenvalues[0, 0] = 1.0
    waves = cv2.dct(bend) / -eigenvalues
    waves[0, 0] = 0.0
    return np.asarray(cv2.dct(waves, flags=cv2.DCT_INVERSE))
