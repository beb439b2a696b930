"""The views of the resolution study: the paper's two, and those that separate what differs between them.

| view | picture | size | trunk |
|---|---|---|---|
| lr | 320x240, its central 224x224 | as it is | in one piece; the paper's low resolution |
| hr_tiled | 1280x720 | as it is | in tiles; the paper's high resolution |
| lr_tiled | 320x240 | scaled to 1280x720 | in tiles: as dense as hr_tiled, without its detail |
| hr_full | 1280x720 | as it is | in one piece: the detail of hr_tiled, without tiles |
| lr_full | 320x240 | as it is | in one piece: the field of view of hr_tiled, at low resolution |

Every view has the same normalisation of pixels, because it is part of the trunk. The common measures are computed in
the field of view of `lr`, on the pixels and masks of 1280x720, for every view.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset import SIZES
from calibration.experiments.harness.pictures import LR_VIEW, View
from edge.core.imaging.known_profiles import LR_PIXELS_PER_MM
from edge.core.imaging.region import Region

__all__ = ["COMMON", "VIEWS", "common_map"]

_LR, _HR = SIZES["lr"], SIZES["hr"]
_ACROSS, _DOWN = _HR[0] // _LR[0], _HR[1] // _LR[1]
# Across, as in the sensor profile of 1280x720; down it is three quarters of this.
_HR_PIXELS_PER_MM = LR_PIXELS_PER_MM * _ACROSS


_HR_FULL, _HR_TILED = (
    View(_HR, Region.full(_HR), _HR_PIXELS_PER_MM, is_tiled=tiled) for tiled in (False, True)
)

VIEWS: Mapping[str, View] = {
    "lr": LR_VIEW,
    "hr_tiled": _HR_TILED,
    "lr_tiled": replace(_HR_TILED, size=_LR, scaled_to=_HR),
    "hr_full": _HR_FULL,
    "lr_full": View(_LR, Region.full(_LR), LR_PIXELS_PER_MM),
}

_CENTRE = LR_VIEW.region
COMMON = Region(_CENTRE.x * _ACROSS, _CENTRE.y * _DOWN, _CENTRE.width * _ACROSS, _CENTRE.height * _DOWN)
"""The field of view of `lr` in pixels of 1280x720."""


def common_map(pixels: NDArray[Any], view: View) -> NDArray[np.float32]:
    """A score map (h, w) of a view in the common field of view: float32 (COMMON.height, COMMON.width)."""
    found = np.asarray(pixels, np.float32)
    if view.region == _CENTRE:
        return np.asarray(cv2.resize(found, (COMMON.width, COMMON.height)), np.float32)
    if found.shape != (_HR[1], _HR[0]):
        found = np.asarray(cv2.resize(found, _HR), np.float32)
    return np.ascontiguousarray(COMMON.crop(found))
