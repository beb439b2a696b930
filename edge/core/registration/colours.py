"""Slopes in colours: a part that is turned under fixed lights shows other colours, not only other places.

The light that a surface adds to the free gel's is close to a linear function of its two slopes, by one 3 x 2 matrix for
the sensor (Woodham 1980; the colour response of three public Minis). Slopes turn with the part. If parts lie at any
angle, or are round, no slope is preferred, so the covariance of the colours is that matrix times its transpose. This
gives the matrix but for a turn of the slopes, which does not matter here, as turns of a plane commute; and but for
a reflection, which is found by trying both.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["SlopeColours"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Below this share of the stronger slope's colours the weaker slope cannot be separated from noise; a Mini has a half.
_LEAST_RATIO = 0.02


@dataclass(frozen=True, eq=False)
class SlopeColours:
    """Colours of slopes: float64 (3, 2), levels per unit of slope, the unit being the slopes' standard deviation."""

    matrix: F64

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 2) or not np.isfinite(self.matrix).all():
            raise ValueError(f"colours of slopes are finite, (3, 2), found {self.matrix.shape}")
        if np.linalg.matrix_rank(self.matrix, tol=_LEAST_RATIO * float(np.abs(self.matrix).max())) < 2:
            raise ValueError(
                "the colours of the two slopes are the same; the lights show one direction alone"
            )

    @classmethod
    def of(cls, differences: F32) -> "SlopeColours":
        """Learn from what presses add to the free gel, float32 (n, 3). Errors: ValueError where there is no relief."""
        moments = differences.T.astype(np.float64) @ differences / max(1, len(differences))
        values, vectors = np.linalg.eigh(moments)
        return cls(vectors[:, 1:] * np.sqrt(np.maximum(values[1:], 0.0)))

    @cached_property
    def _inverse(self) -> F64:
        return np.asarray(np.linalg.pinv(self.matrix), np.float64)

    def mirror(self) -> "SlopeColours":
        """Return the other of the two that explain the same colours."""
        return SlopeColours(self.matrix * [1.0, -1.0])

    def slopes(self, difference: F32) -> F32:
        """Compute slopes, float32 (h, w, 2), of colours (h, w, 3)."""
        return np.asarray(cv2.transform(difference, self._inverse), np.float32)

    def turn_matrix(self, turn_rad: float) -> F64:
        """Compute the colours' change when the part turns, float64 (3, 3); colours that show no slope stay."""
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        turn = np.array([[cos, -sin], [sin, cos]])
        return np.asarray(np.eye(3) + self.matrix @ (turn - np.eye(2)) @ self._inverse, np.float64)
