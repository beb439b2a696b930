"""Pixel AUROC, average precision and AU-PRO to several limits from one sort: for many evaluations of the same presses.

The same values as `auroc`, `average_precision` and `aupro` of all pixels. All three curves rise only at the scores of
defect pixels, so it is enough to count the sound pixels above each of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.regions import Maps, Masks, check_pairs, label_regions

__all__ = ["PooledMeasures", "pool_measures"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class PooledMeasures:
    """None where undefined: no defect pixel, or no sound one. aupro: one per limit."""

    auroc: float | None
    average_precision: float | None
    aupro: tuple[float | None, ...]


@dataclass(frozen=True)
class _Curve:
    """Counts at each distinct score of a defect pixel, falling.

    above, at_or_above: sound pixels. found: defect pixels. overlap: the sum of 1/|region| over them.
    """

    above: Float
    at_or_above: Float
    found: Float
    overlap: Float
    sound: int
    regions: int


def pool_measures(maps: Maps, masks: Masks, limits: Sequence[float]) -> PooledMeasures:
    """Measure all images together. limits: false-positive rates up to which AU-PRO is integrated.

    Errors: ValueError as `aupro`.
    """
    if not all(0 < limit <= 1 for limit in limits):
        raise ValueError(f"an integration limit is in (0, 1], found {tuple(limits)}")
    check_pairs(maps, masks)
    curve = _curve(maps, masks)
    if curve is None:
        return PooledMeasures(None, None, (None,) * len(limits))
    found, total = np.cumsum(curve.found), curve.found.sum()
    ranks = np.sum(curve.found * (curve.sound - 0.5 * (curve.above + curve.at_or_above)))
    return PooledMeasures(
        auroc=float(ranks / (total * curve.sound)),
        average_precision=float(np.sum(curve.found * found / (found + curve.at_or_above)) / total),
        aupro=tuple(_aupro(curve, limit) for limit in limits),
    )


def _curve(maps: Maps, masks: Masks) -> _Curve | None:
    sound = np.sort(np.concatenate([m[~k] for m, k in zip(maps, masks, strict=True)] or [np.empty(0)]))
    scores, overlaps, regions = _defect_pixels(maps, masks)
    if not (scores.size and sound.size):
        return None
    rising, step = np.unique(scores, return_inverse=True)
    above = np.asarray(sound.size - np.searchsorted(sound, rising, side="right"), np.float64)
    at_or_above = np.asarray(sound.size - np.searchsorted(sound, rising, side="left"), np.float64)
    found: Float = np.bincount(step).astype(np.float64)
    overlap = np.asarray(np.bincount(step, overlaps), np.float64)
    return _Curve(
        above=above[::-1],
        at_or_above=at_or_above[::-1],
        found=found[::-1],
        overlap=overlap[::-1],
        sound=sound.size,
        regions=regions,
    )


def _defect_pixels(maps: Maps, masks: Masks) -> tuple[NDArray[np.floating[Any]], Float, int]:
    """The scores of all defect pixels, 1/|region| of each, and the number of regions."""
    scores, overlaps, regions = [], [], 0
    for score_map, mask in zip(maps, masks, strict=True):
        if mask.any():
            labelled = label_regions(mask)
            scores.append(score_map[mask])
            overlaps.append(1.0 / labelled.areas[labelled.labels[mask] - 1])
            regions += labelled.areas.size
    if not regions:
        return np.empty(0), np.empty(0), 0
    return np.concatenate(scores), np.concatenate(overlaps), regions


def _aupro(curve: _Curve, limit: float) -> float:
    """Level between two defect scores, a straight line across a score that both sides share."""
    overlap = np.cumsum(curve.overlap)
    before = np.concatenate([[0.0], overlap[:-1]])
    enter, leave = curve.above / curve.sound, curve.at_or_above / curve.sound
    previous = np.concatenate([[0.0], leave[:-1]])
    level = before * (np.minimum(enter, limit) - np.minimum(previous, limit))
    width = np.minimum(leave, limit) - np.minimum(enter, limit)
    share = width / np.where(leave > enter, leave - enter, 1.0)
    area = np.sum(level + width * (before + 0.5 * share * (overlap - before)))
    area += overlap[-1] * (limit - min(float(leave[-1]), limit))
    return float(area / (curve.regions * limit))
