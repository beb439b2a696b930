"""Where a score map may show damage: on it, and within a cell of it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.damage import Damage
from calibration.simulator.field_of_view import Field, grids

__all__ = ["surroundings"]

# A score map's peak may lie this far outside the damage: a cell of the deepest tap is 16 pixels, 1.0 mm at 320x240.
_OUTSIDE_MM = 1.0
# Damage is where it is deeper than this share of its size: a rim has no end.
_EDGE_SHARE = 0.05


def surroundings(damage: Damage, field: Field) -> NDArray[np.bool_]:
    """The damage and what lies within a cell of it, bool (h, w)."""
    damaged = np.abs(damage.relief(*grids(field))) > _EDGE_SHARE * damage.size_mm
    across, down = (2 * round(_OUTSIDE_MM / m) + 1 for m in field.mm_per_px)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (across, down))
    return np.asarray(cv2.dilate(damaged.astype(np.uint8), reach), np.bool_)
