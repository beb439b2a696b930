"""Arithmetic with the same bits on every processor of one architecture, so a seed gives the same files anywhere.

NumPy and OpenCV choose vector instructions by the processor they find, and these differ in a float32's last bit. So
elementary functions are evaluated in float64, whose last bit is lost in rounding to float32. OpenCV's choice is
switched off while files are made (measured: no slower at these sizes, because its baseline is also vectorised).
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["arcsin", "arctan2", "combine", "cos", "exp", "power", "reproducible_opencv", "sin", "tanh"]

F32 = NDArray[np.float32]


def _f64(values: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)


def exp(x: ArrayLike) -> F32:
    """e to the power x, float32."""
    return np.exp(_f64(x)).astype(np.float32)


def sin(x: ArrayLike) -> F32:
    """Sine of radians, float32."""
    return np.sin(_f64(x)).astype(np.float32)


def cos(x: ArrayLike) -> F32:
    """Cosine of radians, float32."""
    return np.cos(_f64(x)).astype(np.float32)


def tanh(x: ArrayLike) -> F32:
    """Hyperbolic tangent, float32."""
    return np.tanh(_f64(x)).astype(np.float32)


def arcsin(x: ArrayLike) -> F32:
    """Radians whose sine is x in [-1, 1], float32."""
    return np.arcsin(_f64(x)).astype(np.float32)


def arctan2(y: ArrayLike, x: ArrayLike) -> F32:
    """Angle of the point (x, y) in radians, float32."""
    return np.arctan2(_f64(y), _f64(x)).astype(np.float32)


def power(x: ArrayLike, exponent: float) -> F32:
    """x, not negative, to a power, float32."""
    return np.power(_f64(x), exponent).astype(np.float32)


def combine(table: NDArray[np.float64], terms: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Each row's weighted sum of the terms, float64 (rows, h, w), added in their order.

    A matrix product would leave order and rounding to the BLAS library's choice for the processor.
    """
    sums = np.zeros((table.shape[0], *terms[0].shape))
    for row, weights in zip(sums, table.tolist(), strict=True):
        for weight, term in zip(weights, terms, strict=True):
            row += weight * term
    return sums


@contextmanager
def reproducible_opencv() -> Iterator[None]:
    """Run OpenCV on its baseline code; a setting of the process, restored at the end."""
    before = cv2.useOptimized()
    cv2.setUseOptimized(False)
    try:
        yield
    finally:
        cv2.setUseOptimized(before)
