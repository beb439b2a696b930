"""Pixel AUROC, average precision and AU-PRO of one set under many image weightings, exact for each.

A bootstrap replicate is a weight per image. All three curves rise only at the scores of defect pixels. So two counts
are enough at each distinct defect score: the sound pixels of each image above it, and those at or above it. They are
taken once per block of thresholds; a replicate is then a product with its weights, without another sort. Memory is
bounded by the block, not by the number of thresholds or replicates.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.aupro import AUPRO_LIMIT
from calibration.metrics.regions import Maps, Masks, check_pairs, label_regions

__all__ = ["PixelMeasures", "pixel_measures"]

# Elements of one (thresholds, replicates) block: 32 MB of float64 each.
_BLOCK_ELEMENTS = 1 << 22

Float = NDArray[np.float64]


@dataclass(frozen=True)
class PixelMeasures:
    """One value per weighting, float64 (weightings,), NaN where a weighting leaves it undefined."""

    auroc: Float
    average_precision: Float
    aupro: Float


@dataclass(frozen=True)
class _Defects:
    """Defect pixels by falling score. step: index of the distinct score each belongs to."""

    thresholds: NDArray[np.floating[Any]]
    step: NDArray[np.int64]
    image: NDArray[np.int64]
    overlap: Float


@dataclass
class _Sums:
    """State between blocks of thresholds; each is (weightings,)."""

    ranks: Float
    precision: Float
    area: Float
    found: Float = field(init=False)
    overlap: Float = field(init=False)
    rate: Float = field(init=False)

    def __post_init__(self) -> None:
        self.found, self.overlap, self.rate = (np.zeros_like(self.ranks) for _ in range(3))


def pixel_measures(maps: Maps, masks: Masks, weights: Float, limit: float = AUPRO_LIMIT) -> PixelMeasures:
    """The pixel measures for each row of `weights`, float64 (weightings, images), multiplicities of the images.

    A row of ones gives exactly what `auroc`, `average_precision` and `aupro` give for all pixels.
    Errors: ValueError for maps and masks that do not pair, or weights of another shape.
    """
    check_pairs(maps, masks)
    if weights.ndim != 2 or weights.shape[1] != len(maps):
        raise ValueError(f"weights are (weightings, {len(maps)}), found {weights.shape}")
    by_image = np.ascontiguousarray(weights.T)
    defects, regions = _defects(maps, masks)
    sound = [np.sort(m[~k]) for m, k in zip(maps, masks, strict=True)]
    totals = _Totals(
        sound=np.array([s.size for s in sound], np.float64) @ by_image,
        found=np.bincount(defects.image, minlength=len(maps)).astype(np.float64) @ by_image,
        regions=regions @ by_image,
    )
    sums = _Sums(*(np.zeros(weights.shape[0]) for _ in range(3)))
    rows = max(1, _BLOCK_ELEMENTS // weights.shape[0])
    for start in range(0, defects.thresholds.size, rows):
        _add_block(sums, _block(defects, sound, by_image, slice(start, start + rows)), totals, limit)
    return _finish(sums, totals, limit)


@dataclass(frozen=True)
class _Totals:
    """Weighted counts of the set, each (weightings,); zero where a weighting has none."""

    sound: Float
    found: Float
    regions: Float


@dataclass(frozen=True)
class _Block:
    """Weighted counts at a run of falling thresholds, each (thresholds, weightings)."""

    above: Float
    at_or_above: Float
    found: Float
    overlap: Float


def _defects(maps: Maps, masks: Masks) -> tuple[_Defects, Float]:
    """All defect pixels sorted by falling score, and the regions per image, float64 (images,)."""
    scores, image, overlap = [], [], []
    regions = np.zeros(len(maps))
    for index, (score_map, mask) in enumerate(zip(maps, masks, strict=True)):
        if not mask.any():
            continue
        labelled = label_regions(mask)
        regions[index] = labelled.areas.size
        scores.append(score_map[mask])
        overlap.append(1.0 / labelled.areas[labelled.labels[mask] - 1])
        image.append(np.full(scores[-1].size, index, np.int64))
    if not scores:
        return _Defects(np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)), regions
    joined = np.concatenate(scores)
    order = np.argsort(joined)[::-1]
    falling = joined[order]
    first_of_tie = np.append(True, falling[1:] != falling[:-1])
    return _Defects(
        thresholds=falling[first_of_tie],
        step=np.cumsum(first_of_tie) - 1,
        image=np.concatenate(image)[order],
        overlap=np.concatenate(overlap)[order],
    ), regions


def _block(defects: _Defects, sound: list[NDArray[Any]], by_image: Float, run: slice) -> _Block:
    """Count one run of thresholds for every image, then weigh."""
    thresholds = defects.thresholds[run]
    rising = thresholds[::-1]
    above = np.stack([s.size - np.searchsorted(s, rising, side="right") for s in sound], axis=1)[::-1]
    at_or_above = np.stack([s.size - np.searchsorted(s, rising, side="left") for s in sound], axis=1)[::-1]
    first, last = np.searchsorted(defects.step, [run.start, run.start + thresholds.size])
    here = (defects.step[first:last] - run.start) * len(by_image) + defects.image[first:last]
    return _Block(
        above=above.astype(np.float64) @ by_image,
        at_or_above=at_or_above.astype(np.float64) @ by_image,
        found=_weighed(here, np.ones(last - first), thresholds.size, by_image),
        overlap=_weighed(here, defects.overlap[first:last], thresholds.size, by_image),
    )


def _weighed(places: NDArray[np.int64], values: Float, thresholds: int, by_image: Float) -> Float:
    """Values at (threshold, image), summed per threshold with the images' weights: (thresholds, weightings).

    places: threshold * images + image. Nearly every pair is empty, so the product is taken of those that are not.
    """
    distinct, which = np.unique(places, return_inverse=True)
    summed = np.bincount(which, values)
    weighed = np.zeros((thresholds, by_image.shape[1]))
    at_once = max(1, _BLOCK_ELEMENTS // by_image.shape[1])
    for start in range(0, distinct.size, at_once):
        row, image = np.divmod(distinct[start : start + at_once], len(by_image))
        first_of_row = np.flatnonzero(np.append(True, row[1:] != row[:-1]))
        products = summed[start : start + at_once, None] * by_image[image]
        weighed[row[first_of_row]] += np.add.reduceat(products, first_of_row, axis=0)
    return weighed


def _add_block(sums: _Sums, block: _Block, totals: _Totals, limit: float) -> None:
    """Carry the three integrals over one run of thresholds."""
    sums.ranks += np.sum(block.found * (totals.sound - 0.5 * (block.above + block.at_or_above)), axis=0)
    found = sums.found + np.cumsum(block.found, axis=0)
    sums.precision += np.sum(block.found * (found / np.maximum(found + block.at_or_above, 1.0)), axis=0)
    sums.found = found[-1]
    if (sums.rate < limit).any():
        _add_overlap(sums, block, totals, limit)


def _add_overlap(sums: _Sums, block: _Block, totals: _Totals, limit: float) -> None:
    """The overlap curve: level between two defect scores, a straight line across a score that both sides share."""
    overlap = sums.overlap + np.cumsum(block.overlap, axis=0)
    before = np.concatenate([sums.overlap[None], overlap[:-1]])
    sound = np.maximum(totals.sound, 1.0)
    enter, leave = block.above / sound, block.at_or_above / sound
    previous = np.concatenate([sums.rate[None], leave[:-1]])
    level = before * (np.minimum(enter, limit) - np.minimum(previous, limit))
    width = np.minimum(leave, limit) - np.minimum(enter, limit)
    share = width / np.where(leave > enter, leave - enter, 1.0)
    sums.area += np.sum(level + width * (before + 0.5 * share * (overlap - before)), axis=0)
    sums.overlap, sums.rate = overlap[-1], leave[-1]


def _finish(sums: _Sums, totals: _Totals, limit: float) -> PixelMeasures:
    """Close the curves at (1, 1) and normalise."""
    is_defined = (totals.found > 0) & (totals.sound > 0)
    area = sums.area + sums.overlap * (limit - np.minimum(sums.rate, limit))

    def divided(value: Float, by: Float) -> Float:
        return np.where(is_defined, value / np.where(is_defined, by, 1.0), np.nan)

    return PixelMeasures(
        auroc=divided(sums.ranks, totals.found * totals.sound),
        average_precision=divided(sums.precision, totals.found),
        aupro=divided(area, totals.regions * limit),
    )
