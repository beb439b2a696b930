"""Size and depth of a deviation: what a press shows at one place otherwise than a good part does there, in mm.

Both are height maps of the same gel. They are levelled against each other around the deviation, for no two presses are
equally deep or straight; what remains there of the difference is what good presses differ by, and no depth within it is
told.
"""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from edge.core.arrays import F64, Mask
from edge.core.defects import Deviation, longest_extent
from edge.core.heights.calibration import HeightCalibration

__all__ = ["measure_deviation"]

# Around the places above the limit: where their flanks may lie, and up to where sound gel is compared.
_FLANK_MM, _AROUND_MM = 0.4, 1.6
# Of the places around, at least this share must be sound and seen: a plane through fewer says nothing of the middle.
_LEAST_AROUND: Final = 1 / 3
_ROUNDS, _KEEP_SIGMAS, _MAD_TO_SIGMA = 4, 3.0, 1.4826
# What is narrow looks shallower and wider than it is: coat and lens leave of a wave of 0.25 mm 0.4, of 0.5 mm 0.8. By
# so many mm2 over the width squared a depth may be larger: simulated parts, `tests/bench/test_deviations.py`.
_NARROW_MM2: Final = 0.1
_NARROW_MM: Final = 0.4
# Differences below a tenth of a micrometre are arithmetic.
_LEAST_LEFT_MM: Final = 1e-4
# By so many pixels the outline of what is small may be wrong, both ends together.
_EDGES_PX: Final = 3.0


def measure_deviation(
    press_mm: F64, good_mm: Sequence[F64], places: Mask, sound: Mask, calibration: HeightCalibration
) -> Deviation:
    """Measure the deviation at these places, by the good press that fits best around them.

    press_mm, good_mm: heights, float64 (h, w), NaN where nothing is seen. places: bool (h, w), above the limit. sound:
    bool (h, w), judged and not above it.
    """
    px_mm = calibration.mm_per_px
    if not places.any():
        return Deviation(remark="it has no place in the picture")
    reach = _dilate(places, _AROUND_MM / px_mm)
    flank = _dilate(places, _FLANK_MM / px_mm)
    around = reach & ~flank & sound
    expected = _LEAST_AROUND * np.pi * _AROUND_MM**2 / px_mm**2
    levelled = [_level(press_mm - good, around, expected) for good in good_mm]
    best = min((one for one in levelled if one is not None), key=lambda one: one[1], default=None)
    if best is None:
        return Deviation(
            remark="too little around it is sound and seen, so there is nothing to compare it with"
        )
    difference, left_mm = best
    seen = np.isfinite(difference)
    if not (flank & seen).any():
        return Deviation(remark="no good press of the bundle shows this place")
    peak = int(np.where(flank & seen, np.abs(difference), -1.0).argmax())
    raised, sign = abs(float(difference.flat[peak])), float(np.sign(difference.flat[peak]))
    shown = np.where(reach & seen, sign * difference, -np.inf)
    length, width = _extent(shown, raised / 2, peak, px_mm)
    share = calibration.height_u95 + 2 * calibration.scale_u95
    told = left_mm + share * raised
    u95 = told + _NARROW_MM2 / width**2 * raised
    if raised <= told:
        remark = (
            f"what shows of its depth is within {_round(told):g} mm, by which the places around it differ"
        )
        return Deviation(None, _round(u95), remark=remark)
    # Half of the depth is as unsure as the depth: of a ring that is told too deep on one side an arc is above it.
    moved = [_extent(shown, (raised + by) / 2, peak, px_mm)[0] - length for by in (-told, told)]
    size_u95 = max(abs(shift) for shift in moved) + _EDGES_PX * px_mm + calibration.scale_u95 * length
    depth = _round(-sign * raised), _round(u95)
    if width < _NARROW_MM:
        return Deviation(
            *depth, remark="it is as narrow as what the gel shows, and may be deeper and shorter"
        )
    if length <= size_u95:
        return Deviation(*depth, remark="its outline is not told from the places around it")
    return Deviation(*depth, _round(length), _round(size_u95))


def _level(difference: F64, around: Mask, expected: float) -> tuple[F64, float] | None:
    """Level a difference by a plane through the places around, without those that fit it badly; None for too few.

    Returns press less good part, 0 on the whole around the deviation, and the largest that remains there, in mm."""
    usable = around & np.isfinite(difference)
    rows, columns = np.nonzero(usable)
    if len(rows) < max(4, _LEAST_AROUND * expected):
        return None
    at = np.column_stack([columns, rows, np.ones(len(rows))])
    values = difference[usable]
    kept = np.ones(len(rows), np.bool_)
    for _ in range(_ROUNDS):
        plane = np.linalg.lstsq(at[kept], values[kept], rcond=None)[0]
        left = np.abs(values - at @ plane)
        kept = left <= max(_KEEP_SIGMAS * _MAD_TO_SIGMA * float(np.median(left[kept])), _LEAST_LEFT_MM)
    down, across = np.mgrid[0 : difference.shape[0], 0 : difference.shape[1]]
    levelled = difference - (plane[0] * across + plane[1] * down + plane[2])
    return np.asarray(levelled), float(left.max())


def _extent(shown: F64, level: float, peak: int, px_mm: float) -> tuple[float, float]:
    """Return length and width of what hangs together with the peak above a level, mm."""
    above = shown >= min(max(level, _LEAST_LEFT_MM), 0.98 * float(shown.flat[peak]))
    labels = cv2.connectedComponents(above.astype(np.uint8), connectivity=8)[1]
    inside = labels == labels.flat[peak]
    framed = cv2.copyMakeBorder(inside.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    inscribed = 2.0 * float(cv2.distanceTransform(framed, cv2.DIST_L2, 5).max()) - 1.0
    return longest_extent(inside) * px_mm, inscribed * px_mm


def _dilate(places: Mask, reach_px: float) -> Mask:
    reach = max(1, round(reach_px))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(places.astype(np.uint8), kernel) > 0)


def _round(mm: float) -> float:
    """Round to micrometres."""
    return round(mm, 3)
