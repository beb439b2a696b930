"""Defect regions of a mask: 8-connected, as the official MVTec AD evaluation counts them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Maps", "Masks", "Regions", "check_pairs", "label_regions"]

Maps = Sequence[NDArray[np.floating[Any]]] | NDArray[np.floating[Any]]
"""Score maps, one (h, w) per image: raw, higher is more anomalous. Sizes may differ between images."""

Masks = Sequence[NDArray[np.bool_]] | NDArray[np.bool_]
"""Defect masks, bool (h, w) each, True where the defect is; all False for a good image."""


@dataclass(frozen=True)
class Regions:
    """The connected defects of one mask. labels: int32 (h, w), 0 is sound. areas: int64 (regions,), in pixels."""

    labels: NDArray[np.int32]
    areas: NDArray[np.int64]


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
