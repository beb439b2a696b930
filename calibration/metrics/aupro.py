"""AU-PRO, exact: the official MVTec AD definition, sorting only the pixels that can matter.

Ref: Bergmann et al., "The MVTec Anomaly Detection Dataset", IJCV 2021, and the evaluation code published with it. Every
pixel outside a defect, of every image, is one false-positive count; every pixel of region k is 1/|k| of overlap. Equal
scores are one threshold. The area is the trapezoid up to the limit, linear at the limit, divided by the limit. All
regions have the same weight, whatever their size.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.regions import Maps, Masks, check_pairs, label_regions

__all__ = ["AUPRO_LIMIT", "aupro", "trapezoid_to_limit"]

# The paper integrates to one per cent false positives; MVTec AD's own default is 0.3.
AUPRO_LIMIT = 0.01


def aupro(maps: Maps, masks: Masks, limit: float = AUPRO_LIMIT) -> float | None:
    """Area under the per-region overlap curve up to the false-positive rate `limit`, normalised to 0..1.

    None when undefined: no defect region, or no sound pixel. Counts are int64 and areas float64, so sets of any size
    are exact. Only scores at or above the (1 - limit) quantile of sound pixels enter the curve. Errors: ValueError for
    a limit outside (0, 1], a non-finite map, or a mask of another size.
    """
    if not 0 < limit <= 1:
        raise ValueError(f"the integration limit is in (0, 1], found {limit}")
    check_pairs(maps, masks)
    sound = np.concatenate([m[~k] for m, k in zip(maps, masks, strict=True)]) if len(maps) else np.empty(0)
    scores, overlaps, regions = _region_pixels(maps, masks)
    if not regions or not sound.size:
        return None
    # The smallest count of false positives beyond the limit: the curve needs that point to interpolate.
    beyond = min(int(limit * sound.size) + 1, sound.size)
    lowest = np.partition(sound, sound.size - beyond)[sound.size - beyond]
    return _area(sound[sound >= lowest], sound.size, scores, overlaps, lowest, regions, limit)


def _region_pixels(maps: Maps, masks: Masks) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Scores of all defect pixels, the overlap 1/|region| of each, and how many regions there are."""
    scores: list[NDArray[np.float64]] = []
    overlaps: list[NDArray[np.float64]] = []
    count = 0
    for score_map, mask in zip(maps, masks, strict=True):
        if mask.any():
            regions = label_regions(mask)
            scores.append(score_map[mask].astype(np.float64))
            overlaps.append(1.0 / regions.areas[regions.labels[mask] - 1])
            count += regions.areas.size
    if not count:
        return np.empty(0), np.empty(0), 0
    return np.concatenate(scores), np.concatenate(overlaps), count


def _area(
    top: NDArray[np.floating[Any]],
    sound_pixels: int,
    scores: NDArray[np.float64],
    overlaps: NDArray[np.float64],
    lowest: float,
    regions: int,
    limit: float,
) -> float:
    """The normalised area of the curve made of the sound scores `top` and the defect scores at or above `lowest`."""
    kept = scores >= lowest
    joined = np.concatenate([top.astype(np.float64), scores[kept]])
    order = np.argsort(joined)[::-1]
    false_positive = (order < top.size).astype(np.int64)
    overlap = np.concatenate([np.zeros(top.size), overlaps[kept]])[order]
    ordered = joined[order]
    last_of_tie = np.append(ordered[1:] != ordered[:-1], True)
    fpr = np.cumsum(false_positive)[last_of_tie] / sound_pixels
    pro = np.minimum(np.cumsum(overlap)[last_of_tie] / regions, 1.0)
    x = np.concatenate([[0.0], fpr, [1.0]])
    y = np.concatenate([[0.0], pro, [1.0]])
    return trapezoid_to_limit(x, y, limit) / limit


def trapezoid_to_limit(x: NDArray[np.float64], y: NDArray[np.float64], limit: float) -> float:
    """The area under the points (x rising) from 0 to `limit`, the last piece interpolated linearly."""
    inside = int(np.searchsorted(x, limit, side="right"))
    area = float(np.sum((x[1:inside] - x[: inside - 1]) * (y[1:inside] + y[: inside - 1])) / 2)
    if inside < x.size:
        step = limit - x[inside - 1]
        slope = (y[inside] - y[inside - 1]) / (x[inside] - x[inside - 1])
        area += float(step * (y[inside - 1] + slope * step / 2))
    return area
