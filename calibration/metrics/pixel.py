"""Pixel AUROC, average precision and AU-PRO of one set under many image weightings, exact for each.

Ref: Bergmann et al., "The MVTec Anomaly Detection Dataset", IJCV 2021, and the evaluation code published with it. Every
pixel outside a defect, of every image, is one false-positive count; every pixel of region k is 1/|k| of overlap. Equal
scores are one threshold. The area is the trapezoid up to the limit, linear at the limit, divided by the limit. All
regions have the same weight, whatever their size.

A bootstrap replicate is a weight per image. All three curves rise only at the scores of defect pixels. So two counts
are enough at each distinct defect score: the sound pixels of each image above it, and those at or above it. They are
taken once per block of thresholds; a replicate is then a product with its weights, without another sort. Memory is
bounded by the block, not by the number of thresholds or replicates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64, Mask

__all__ = [
    "AUPRO_LIMIT",
    "Maps",
    "Masks",
    "PixelMeasures",
    "aupro",
    "check_pairs",
    "pixel_measures",
    "pool_measures",
]

# The paper integrates to one per cent false positives; MVTec AD's own default is 0.3.
AUPRO_LIMIT = 0.01

Maps = Sequence[NDArray[np.floating[Any]]] | NDArray[np.floating[Any]]
"""Score maps, one (h, w) per image: raw, higher is more anomalous. Sizes may differ between images."""

Masks = Sequence[Mask] | Mask
"""Defect masks, bool (h, w) each, True where the defect is; all False for a good image."""

# Elements of one (thresholds, weightings) block: 32 MB of float64 each.
_BLOCK_ELEMENTS = 1 << 22


@dataclass(frozen=True)
class PixelMeasures:
    """One value per weighting, float64 (weightings,), NaN where a weighting leaves it undefined."""

    auroc: F64
    average_precision: F64
    aupro: F64


@dataclass(frozen=True)
class PooledMeasures:
    """Measures of all images together; None where undefined: no defect pixel, or no sound one."""

    auroc: float | None
    average_precision: float | None
    aupro: tuple[float | None, ...]
    """One for each limit."""


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

    None when undefined: no defect region, or no sound pixel. Errors: ValueError for a limit outside (0, 1], a
    non-finite map, or a mask of another size.
    """
    return pool_measures(maps, masks, (limit,)).aupro[0]


def pixel_measures(maps: Maps, masks: Masks, weights: F64, limit: float = AUPRO_LIMIT) -> PixelMeasures:
    """Measure the pixels for each row of `weights`, float64 (weightings, images), multiplicities of the images.

    A row of ones gives exactly what `auroc`, `average_precision` and `aupro` give for all pixels.
    Errors: ValueError for maps and masks that do not pair, or weights of another shape.
    """
    check_pairs(maps, masks)
    if weights.ndim != 2 or weights.shape[1] != len(maps):
        raise ValueError(f"weights are (weightings, {len(maps)}), found {weights.shape}")
    sound = [np.sort(m[~k]) for m, k in zip(maps, masks, strict=True)]
    auroc, precision, areas = _integrate(*_sort_defects(maps, masks), sound, weights, (limit,))
    return PixelMeasures(auroc, precision, areas[0])


def pool_measures(maps: Maps, masks: Masks, limits: Sequence[float]) -> PooledMeasures:
    """Measure all images as one, from one sort. limits: false-positive rates up to which AU-PRO is integrated.

    Errors: ValueError as `aupro`.
    """
    if not all(0 < limit <= 1 for limit in limits):
        raise ValueError(f"an integration limit is in (0, 1], found {tuple(limits)}")
    check_pairs(maps, masks)
    sound = np.sort(np.concatenate([m[~k] for m, k in zip(maps, masks, strict=True)] or [np.empty(0)]))
    defects, regions = _sort_defects(maps, masks)
    defects = _Defects(defects.thresholds, defects.step, np.zeros_like(defects.image), defects.overlap)
    integrals = _integrate(defects, regions.sum(keepdims=True), [sound], np.ones((1, 1)), limits)
    auroc, precision, *areas = (
        float(value[0]) if np.isfinite(value[0]) else None for value in (*integrals[:2], *integrals[2])
    )
    return PooledMeasures(auroc, precision, tuple(areas))


@dataclass(frozen=True)
class _Defects:
    """All defect pixels by falling score."""

    thresholds: NDArray[np.floating[Any]]
    """Their distinct scores, falling."""
    step: NDArray[np.int64]
    """The index of the distinct score of each pixel."""
    image: NDArray[np.int64]
    overlap: F64
    """1/|region| of each pixel."""


def _sort_defects(maps: Maps, masks: Masks) -> tuple[_Defects, F64]:
    """The defect pixels by falling score, and the regions of each image, float64 (images,).

    Regions are 8-connected: a thin scratch is one.
    """
    regions, overlaps = np.zeros(len(maps)), [np.empty(0)]
    for index, mask in enumerate(masks):
        count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
        areas = np.bincount(labels.ravel(), minlength=count)
        overlaps.append(1.0 / areas[labels[mask]])
        regions[index] = count - 1
    scores = np.concatenate([np.empty(0), *(m[k] for m, k in zip(maps, masks, strict=True))])
    image = np.repeat(np.arange(len(maps)), np.array([mask.sum() for mask in masks], np.int64))
    order = np.argsort(scores)[::-1]
    falling = scores[order]
    first_of_tie = np.append(True, falling[1:] != falling[:-1])[: falling.size]
    overlap = np.concatenate(overlaps)[order]
    return _Defects(falling[first_of_tie], np.cumsum(first_of_tie) - 1, image[order], overlap), regions


@dataclass
class _Curves:
    """The integrals up to a threshold, and the weighted totals of the set; (weightings,) each."""

    limits: F64
    """(limits, 1)."""
    sound: F64
    found_in_all: F64
    regions: F64
    area: F64
    """(limits, weightings)."""
    ranks: F64 = field(init=False)
    precision: F64 = field(init=False)
    found: F64 = field(init=False)
    overlap: F64 = field(init=False)
    rate: F64 = field(init=False)

    def __post_init__(self) -> None:
        self.ranks, self.precision, self.found, self.overlap, self.rate = np.zeros((5, *self.sound.shape))

    def add(self, above: F64, at_or_above: F64, found: F64, overlap: F64) -> None:
        """Carry the integrals over a run of falling thresholds; weighted counts, (thresholds, weightings) each."""
        self.ranks += np.sum(found * (self.sound - 0.5 * (above + at_or_above)), axis=0)
        so_far = self.found + np.cumsum(found, axis=0)
        self.precision += np.sum(found * (so_far / np.maximum(so_far + at_or_above, 1.0)), axis=0)
        self.found = so_far[-1]
        if (self.rate < self.limits).any():
            self._add_overlap(above, at_or_above, overlap)

    def _add_overlap(self, above: F64, at_or_above: F64, overlap: F64) -> None:
        """Integrate the overlap: level between two defect scores, straight across a score that both sides share."""
        reached = self.overlap + np.cumsum(overlap, axis=0)
        before = np.concatenate([self.overlap[None], reached[:-1]])
        sound = np.maximum(self.sound, 1.0)
        enter, leave = above / sound, at_or_above / sound
        previous = np.concatenate([self.rate[None], leave[:-1]])
        for area, limit in zip(self.area, self.limits[:, 0], strict=True):
            level = before * (np.minimum(enter, limit) - np.minimum(previous, limit))
            width = np.minimum(leave, limit) - np.minimum(enter, limit)
            share = width / np.where(leave > enter, leave - enter, 1.0)
            area += np.sum(level + width * (before + 0.5 * share * (reached - before)), axis=0)
        self.overlap, self.rate = reached[-1], leave[-1]

    def close(self) -> tuple[F64, F64, F64]:
        """Close the curves at (1, 1) and normalise: AUROC, average precision, AU-PRO (limits, weightings)."""
        is_defined = (self.found_in_all > 0) & (self.sound > 0)
        area = self.area + self.overlap * (self.limits - np.minimum(self.rate, self.limits))

        def divide(value: F64, by: F64) -> F64:
            return np.where(is_defined, value / np.where(is_defined, by, 1.0), np.nan)

        return (
            divide(self.ranks, self.found_in_all * self.sound),
            divide(self.precision, self.found_in_all),
            divide(area, self.regions * self.limits),
        )


def _integrate(
    defects: _Defects, regions: F64, sound: list[NDArray[Any]], weights: F64, limits: Sequence[float]
) -> tuple[F64, F64, F64]:
    """AUROC and average precision (weightings,) and AU-PRO (limits, weightings).

    regions: of each image. sound: the sound pixels of each image, rising. weights: (weightings, images).
    """
    by_image = np.ascontiguousarray(weights.T)
    count, weightings = by_image.shape
    curves = _Curves(
        limits=np.asarray(limits, np.float64)[:, None],
        sound=np.array([s.size for s in sound], np.float64) @ by_image,
        found_in_all=np.bincount(defects.image, minlength=count).astype(np.float64) @ by_image,
        regions=regions @ by_image,
        area=np.zeros((len(limits), weightings)),
    )
    rows = max(1, _BLOCK_ELEMENTS // weightings)
    for start in range(0, defects.thresholds.size, rows):
        falling = defects.thresholds[start : start + rows]
        above, at_or_above = (
            np.stack([s.size - np.searchsorted(s, falling[::-1], side) for s in sound], axis=1)[::-1]
            for side in ("right", "left")
        )
        first, last = np.searchsorted(defects.step, [start, start + falling.size])
        here = (defects.step[first:last] - start) * count + defects.image[first:last]
        curves.add(
            above.astype(np.float64) @ by_image,
            at_or_above.astype(np.float64) @ by_image,
            _weigh(here, np.ones(last - first), falling.size, by_image),
            _weigh(here, defects.overlap[first:last], falling.size, by_image),
        )
    return curves.close()


def _weigh(places: NDArray[np.int64], values: F64, thresholds: int, by_image: F64) -> F64:
    """Sum values at (threshold, image) per threshold with the images' weights: (thresholds, weightings).

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
