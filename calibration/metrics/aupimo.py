"""AUPIMO: recall of each defective image at a very low false-alarm rate, which good images alone define.

Ref: Bertoldo et al., "AUPIMO: Redefining Visual Anomaly Detection Benchmarks with High Speed and Low Tolerance", BMVC
2024. The shared false-positive rate of a threshold is the mean, over good images, of the share of their pixels at or
above it; the recall of a defective image is averaged over the logarithm of that rate between two bounds. The published
code samples thresholds; this is exact: between two rates that the good pixels can reach, the lower one is used, so the
value is never too high.
"""

import math

import numpy as np

from calibration.metrics.pixel import Maps, Masks, check_pairs
from edge.core.arrays import F64, Mask

__all__ = ["AUPIMO_BOUNDS", "aupimo_means"]

# The bounds of the AUPIMO paper: one to ten false pixels in a hundred thousand.
AUPIMO_BOUNDS = (1e-5, 1e-4)
# A replicate over specimens may hold more good images than the set; twice as many is covered exactly.
_SPARE = 2


def aupimo_means(
    maps: Maps,
    masks: Masks,
    weights: F64,
    bounds: tuple[float, float] = AUPIMO_BOUNDS,
    is_defective: Mask | None = None,
) -> F64:
    """The mean over defective images for each row of `weights`, (weightings, images); NaN where undefined.

    is_defective: bool (images,), by the masks unless given; a defective image with an empty mask is neither good nor
    has it a recall.
    """
    table = _recall_table(maps, masks, bounds, is_defective)
    values = np.full(weights.shape[0], np.nan)
    if table is None:
        return values
    recalls, shares, good, defective = table
    is_defined = (weights[:, good].sum(axis=1) > 0) & (weights[:, defective].sum(axis=1) > 0)
    kept = weights[is_defined]
    per_image = _log_spans(shares, kept[:, good], bounds) @ recalls.T
    by = kept[:, defective]
    values[is_defined] = np.sum(per_image * by, axis=1) / by.sum(axis=1)
    return values


def _recall_table(
    maps: Maps, masks: Masks, bounds: tuple[float, float], is_defective: Mask | None
) -> tuple[F64, F64, list[int], list[int]] | None:
    """Recalls (defective, thresholds) strictly above each falling good score, and the share of one pixel there.

    shares: (thresholds, good), the rate that each threshold adds in each good image. Of each image only the top pixels
    are kept, enough to reach the upper bound alone.
    """
    check_pairs(maps, masks)
    if not 0 < bounds[0] < bounds[1] <= 1:
        raise ValueError(f"the bounds are 0 < lower < upper <= 1, found {bounds}")
    has_defect = np.array([bool(k.any()) for k in masks], np.bool_)
    is_good = ~has_defect if is_defective is None else ~(has_defect | is_defective)
    good, defective = np.flatnonzero(is_good).tolist(), np.flatnonzero(has_defect).tolist()
    if not good or not defective:
        return None
    tops = []
    for index in good:
        flat = maps[index].ravel()
        keep = min(flat.size, int(_SPARE * bounds[1] * len(good) * flat.size) + 2)
        tops.append(np.partition(flat, flat.size - keep)[flat.size - keep :])
    thresholds = np.unique(np.concatenate(tops))[::-1]
    shares = np.zeros((thresholds.size, len(good)))
    rising = thresholds[::-1]
    for column, (index, top) in enumerate(zip(good, tops, strict=True)):
        places = thresholds.size - 1 - np.searchsorted(rising, top)
        np.add.at(shares[:, column], places, 1.0 / maps[index].size)
    rising_defects = [np.sort(maps[i][masks[i]]) for i in defective]
    recalls = np.stack([1.0 - np.searchsorted(d, thresholds, side="right") / d.size for d in rising_defects])
    return recalls, shares, good, defective


def _log_spans(shares: F64, weights: F64, bounds: tuple[float, float]) -> F64:
    """The share of the log range in which each threshold is the strictest; (weightings, thresholds), sums to 1."""
    rate = np.cumsum((weights / weights.sum(axis=1, keepdims=True)) @ shares.T, axis=1)
    low, high = (math.log(b) for b in bounds)
    # Before the k-th good score is passed, the rate is that of the scores above it.
    reached = np.concatenate([np.zeros((weights.shape[0], 1)), rate], axis=1)
    edges = np.log(np.clip(reached, *bounds))
    edges[:, -1] = high
    spans: F64 = np.diff(edges, axis=1) / (high - low)
    return spans
