"""Arithmetic with the same bits on every processor of one architecture, so a seed gives the same files anywhere.

NumPy and OpenCV choose vector instructions by the processor they find, and these differ in a float32's last bit. So
elementary functions are evaluated in float64, whose last bit is lost in rounding to float32. OpenCV's choice is
switched off while files are made (measured: no slower at these sizes, because its baseline is also vectorised).
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import cv2
import numpy as np
from numpy.typing import ArrayLike

from edge.core.arrays import F32, F64

__all__ = ["arcsin", "arctan2", "combine", "cos", "exp", "power", "reproducible_opencv", "sin", "tanh"]


def _in_float64(function: np.ufunc) -> Callable[..., F32]:
    """Evaluate a function in float64, and round its values to float32."""

    def evaluate(*values: ArrayLike) -> F32:
        return np.asarray(function(*(np.asarray(each, np.float64) for each in values)), np.float32)

    return evaluate


exp, tanh, power = _in_float64(np.exp), _in_float64(np.tanh), _in_float64(np.power)
sin, cos, arcsin, arctan2 = (_in_float64(each) for each in (np.sin, np.cos, np.arcsin, np.arctan2))


def combine(table: F64, terms: Sequence[F64]) -> F64:
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
