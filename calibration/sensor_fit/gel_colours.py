"""The untouched gel of a sensor: its colours as a polynomial, the noise of one frame, and the dots of a marker gel."""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from calibration.simulator.camera import NOISE_LEVEL
from calibration.simulator.field_of_view import LR
from calibration.simulator.sensor_appearance import free_gel_powers
from edge.core.arrays import F32, F64, U8, Mask

__all__ = ["fit_free_gel", "fit_noise", "has_markers", "marker_dots"]

# A marker dot: darker than its surroundings of 17 pixels by this much, with an area in this range, in pixels of
# 320x240. A gel with fewer has specks, not markers: real gels have up to 43 dark specks, smaller than a dot.
_DOT_LEVELS, _SURROUNDINGS_PX, _DOT_AREA_PX, _FEWEST_DOTS = 25, 17, (30, 300), 20
_RIM_PX = 5
# Of the polynomial: degree 4 leaves 2.1 levels of real free gels, degree 6 leaves 1.6, noise included.
_DEGREE = 6
# Slower changes than this are light, not noise.
_NOISE_SMOOTH_PX = 2.0
# Of a normal distribution: standard deviation over median absolute deviation.
_SD_OF_MAD = 1.4826


def fit_free_gel(planes: F32, ignored: Mask) -> F64:
    """The table `free_gel` of `SensorAppearance` from planes (3, h, w) of the untouched gel, where not ignored."""
    seen = np.maximum(planes[:, ~ignored].astype(np.float64), 1.0)
    powers = np.array([power[~ignored] for power in free_gel_powers(LR, _DEGREE)])
    # Weighted with the level: the error of a logarithm is that of the level over the level.
    return np.array(
        [np.linalg.lstsq((powers * level).T, np.log(level) * level, rcond=None)[0] for level in seen]
    )


def fit_noise(
    changes: Sequence[F32], untouched: Sequence[Mask], level: Sequence[float]
) -> tuple[float, float, float]:
    """The sd of one frame at the level 100 that the simulator's noise has, of red, green and blue.

    changes: presses without the free gel, float32 (3, h, w); untouched: bool (h, w) each. Two following presses are
    compared where neither touches, so dirt and scratches cancel.
    level: of the free gel in each colour, its mean.
    """
    spreads: list[list[float]] = []
    for (change, other), (free, free_too) in zip(pairwise(changes), pairwise(untouched), strict=True):
        fine = [plane - cv2.GaussianBlur(plane, (0, 0), _NOISE_SMOOTH_PX) for plane in change - other]
        middle = [float(np.median(np.abs(plane[free & free_too]))) for plane in fine]
        spreads.append([_SD_OF_MAD * each / 2**0.5 for each in middle])
    # Half of the variance grows with the light (`camera.noise`).
    growth = np.sqrt(0.5 * np.array(level) / NOISE_LEVEL + 0.5)
    red, green, blue = (np.median(np.array(spreads), axis=0) / growth).tolist()
    return (red, green, blue)


def marker_dots(planes: F32) -> Mask:
    """Find where dark dots and their rims lie, bool (h, w)."""
    dark = _dark(planes)
    return np.asarray(cv2.dilate(dark, np.ones((_RIM_PX, _RIM_PX), np.uint8)), np.bool_)


def has_markers(planes: F32) -> bool:
    """Say whether the free gel carries the dots of a tracking gel."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(_dark(planes))
    area = stats[1:, cv2.CC_STAT_AREA]
    return int(((area >= _DOT_AREA_PX[0]) & (area <= _DOT_AREA_PX[1])).sum()) >= _FEWEST_DOTS


def _dark(planes: F32) -> U8:
    grey = planes.mean(axis=0).astype(np.float32)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))
    return np.asarray(cv2.morphologyEx(grey, cv2.MORPH_BLACKHAT, kernel) > _DOT_LEVELS, np.uint8)
