"""Slopes in colours: a part that is turned under fixed lights shows other colours, not only other places.

The light that a surface adds to the free gel's is close to a linear function of its two slopes, by one 3 x 2 matrix for
the sensor (Woodham 1980; the colour response of three public Minis). Slopes turn with the part. If parts lie at any
angle, or are round, no slope is preferred, so the covariance of the colours is that matrix times its transpose. This
gives the matrix but for a turn of the slopes, which does not matter here, as turns of a plane commute; and but for
a reflection, which is found by trying both: by the wrong one presses that turn do not agree, and a held part is no
surface.

The lights reach the corners of the gel weakly, and a slope there shows its colour as weakly. So what a press adds is
first divided by the free gel's own light: then a part shows the same wherever it lies.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from edge.core.arrays import F32, F64, U8
from edge.core.contact.reference import fit_levels

__all__ = ["FreeLight", "SlopeColours", "curl_share"]

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


# Noise has as much curl as not, so slopes are smoothed before they are differentiated.
_CURL_SMOOTHED_PX = 1.0


def curl_share(slopes: F32) -> float:
    """Compute the share of the slopes' changes that no surface has, 0 to 0.5. slopes: float32 (h, w, 2), in any turn.

    The slopes of a surface have no curl in one of the turns. Slopes of which one is reversed have curl in every turn,
    but for relief in one direction alone, as of a straight edge.
    """
    smooth = np.asarray(cv2.GaussianBlur(slopes, (0, 0), _CURL_SMOOTHED_PX), np.float64)
    down, across = np.gradient(smooth, axis=0), np.gradient(smooth, axis=1)
    parts = np.stack([across[..., 1] - down[..., 0], across[..., 0] + down[..., 1]]).reshape(2, -1)
    least, most = np.linalg.eigvalsh(parts @ parts.T).tolist()
    return least / (least + most) if most > 0 else 0.0


# The light is the free gel without its grain and dust, as a share of its median; weaker places would amplify noise.
_SMOOTH_SHARE = 0.05
_LEAST_LIGHT = 0.2
# The level is fitted on a picture of about this size, as contact detection does.
_LEVEL_SIDE_PX = 112


class FreeLight:
    """The free gel of a sensor. free: uint8 (h, w, 3)."""

    def __init__(self, free: U8) -> None:
        self._free = free.astype(np.float32)
        smooth = cv2.GaussianBlur(self._free, (0, 0), _SMOOTH_SHARE * max(free.shape))
        middle = np.maximum(np.median(smooth, axis=(0, 1)), 1.0)
        self._light = np.maximum(smooth / middle, np.float32(_LEAST_LIGHT))
        self._inverse = 1 / self._light
        self._small = _level_view(free)

    def find_change(self, rgb: U8) -> F32:
        """Find what a press adds, float32 (h, w, 3), levels in the middle of the gel. rgb: uint8 (h, w, 3)."""
        levels = fit_levels(_level_view(rgb), self._small)
        scale, offset = levels.gain.astype(np.float64), levels.offset.astype(np.float64)
        matrix = np.concatenate([np.diag(scale), offset[:, None]], axis=1)
        added = np.asarray(cv2.transform(rgb.astype(np.float32), matrix), np.float32)
        added -= self._free
        added *= self._inverse
        return np.asarray(added, np.float32)

    def picture(self, added: F32) -> U8:
        """The press that adds this, uint8 (h, w, 3)."""
        return np.asarray(cv2.convertScaleAbs(np.maximum(self.levels(added), 0)), np.uint8)

    def levels(self, added: F32) -> F32:
        """The levels of the press that adds this, float32 (h, w, 3), neither rounded nor clipped."""
        return np.asarray(self._free + self._light * added, np.float32)

    def apply_change(self, levels: F32, change: F32, weight: F32) -> U8:
        """Make a picture with these levels and a weighted change of what is added, uint8 (h, w, 3). weight: (h, w)."""
        shows = cv2.multiply(cv2.cvtColor(weight, cv2.COLOR_GRAY2RGB), self._light)
        return np.asarray(cv2.add(levels, cv2.multiply(change, shows, dst=shows), dtype=cv2.CV_8U), np.uint8)


def _level_view(rgb: U8) -> F32:
    factor = _LEVEL_SIDE_PX / max(rgb.shape)
    if factor >= 1:
        return rgb.astype(np.float32)
    return cv2.resize(rgb, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA).astype(np.float32)
