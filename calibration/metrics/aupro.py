"""AU-PRO, exact: the official MVTec AD definition, sorting only the pixels that can matter.

Ref: Bergmann et al., "The MVTec Anomaly Detection Dataset", IJCV 2021, and the evaluation code published with it. Every
pixel outside a defect, of every image, is one false-positive count; every pixel of region k is 1/|k| of overlap. Equal
scores are one threshold. The area is the trapezoid up to the limit, linear at the limit, divided by the limit. All
regions have the same weight, whatever their size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AUPRO_LIMIT",
    "Maps",
    "Masks",
    "Regions",
    "aupro",
    "check_pairs",
    "find_defect_pixels",
    "label_regions",
]

# The paper integrates to one per cent false positives; MVTec AD's own default is 0.3.
AUPRO_LIMIT = 0.01


Maps = Sequence[NDArray[np.floating[Any]]] | NDArray[np.floating[Any]]
"""Score maps, one (h, w) per image: raw, higher is more anomalous. Sizes may differ between images."""

Masks = Sequence[NDArray[np.bool_]] | NDArray[np.bool_]
"""Defect masks, bool (h, w) each, True where the defect is; all False for a good image."""


@dataclass(frozen=True)
class Regions:
    """The connected defects of one mask."""

    labels: NDArray[np.int32]
    """int32 (h, w), 0 is sound."""
    areas: NDArray[np.int64]
    """int64 (regions,), in pixels."""


def label_regions(mask: NDArray[np.bool_]) -> Regions:
    """The 8-connected regions of one mask; diagonal neighbours are connected, so a thin scratch is one region."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S)
    areas = np.bincount(labels.ravel(), minlength=count)[1:]
    return Regions(labels.astype(np.int32, copy=False), areas.astype(np.int64))


def check_pairs(maps: Maps, masks: Masks) -> None:
    """Refuse pairs that cannot be measured. Errors: ValueError naming the image, what was found and expected."""
    if len(maps) != len(masks):
        raise ValueError(f"each score map needs a mask, found {len(maps)} maps and {len(masks)} masks")
    for index, (score_map, mask) in enumerate(zip(maps, masks, strict=True)):
        if score_map.ndim != 2 or score_map.shape != mask.shape:
            raise ValueError(
                f"image {index}: map {score_map.shape} and mask {mask.shape} must be equal (h, w)"
            )
        if mask.dtype != np.bool_:
            raise ValueError(f"image {index}: the mask must be bool, found {mask.dtype}")
        if not np.isfinite(score_map).all():
            raise ValueError(f"image {index}: the score map holds NaN or infinity, which has no rank")


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
    scores, overlaps, _, regions = find_defect_pixels(maps, masks)
    if not scores.size or not sound.size:
        return None
    # The smallest count of false positives beyond the limit: the curve needs that point to interpolate.
    beyond = min(int(limit * sound.size) + 1, sound.size)
    lowest = np.partition(sound, sound.size - beyond)[sound.size - beyond]
    return _area(sound[sound >= lowest], sound.size, scores, overlaps, lowest, regions.sum(), limit)


def find_defect_pixels(
    maps: Maps, masks: Masks
) -> tuple[NDArray[np.floating[Any]], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Scores of all defect pixels, the overlap 1/|region| and the image of each; the regions of each image."""
    scores: list[NDArray[np.floating[Any]]] = []
    overlaps: list[NDArray[np.float64]] = []
    regions = np.zeros(len(maps))
    images = np.repeat(np.arange(len(maps)), np.array([mask.sum() for mask in masks], np.int64))
    for index, (score_map, mask) in enumerate(zip(maps, masks, strict=True)):
        if mask.any():
            labelled = label_regions(mask)
            scores.append(score_map[mask])
            overlaps.append(1.0 / labelled.areas[labelled.labels[mask] - 1])
            regions[index] = labelled.areas.size
    if not scores:
        return np.empty(0), np.empty(0), images, regions
    return np.concatenate(scores), np.concatenate(overlaps), images, regions


def _area(
    top: NDArray[np.floating[Any]],
    sound_pixels: int,
    scores: NDArray[np.floating[Any]],
    overlaps: NDArray[np.float64],
    lowest: float,
    regions: float,
    limit: float,
) -> float:
    """The normalised area of the curve made of the sound scores `top` and the defect scores at or above `lowest`."""
    kept = scores >= lowest
    joined = np.concatenate([top, scores[kept]]).astype(np.float64)
    order = np.argsort(joined)[::-1]
    false_positive = (order < top.size).astype(np.int64)
    overlap = np.concatenate([np.zeros(top.size), overlaps[kept]])[order]
    ordered = joined[order]
    last_of_tie = np.append(ordered[1:] != ordered[:-1], True)
    fpr = np.cumsum(false_positive)[last_of_tie] / sound_pixels
    pro = np.minimum(np.cumsum(overlap)[last_of_tie] / regions, 1.0)
    x = np.concatenate([[0.0], fpr, [1.0]])
    y = np.concatenate([[0.0], pro, [1.0]])
    inside = int(np.searchsorted(x, limit, side="right"))
    x, y = np.append(x[:inside], limit), np.append(y[:inside], np.interp(limit, x, y))
    return float(np.sum(np.diff(x) * (y[1:] + y[:-1])) / 2 / limit)
