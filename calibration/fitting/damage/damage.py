"""Damage of known size as a change of a part's height: the simulator's dents and scratches, and bumps."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.simulator.defects import DENT_DEPTH_MM, SCRATCH_DEPTH_MM, Damaged, Defect
from calibration.simulator.field_of_view import Field, grids
from edge.core.arrays import F32, Mask

__all__ = ["KINDS", "Damage", "Spot", "surroundings"]

# A score map's peak may lie this far outside the damage: a cell of the deepest tap is 16 pixels, 1.0 mm at 320x240.
_OUTSIDE_MM = 1.0
# Damage is where it is deeper than this share of its size: a rim has no end.
_EDGE_SHARE = 0.05


@dataclass(frozen=True)
class Kind:
    """One kind of damage."""

    shape: str
    """The simulator's defect, whose severity 1 is `largest_mm` deep."""
    largest_mm: float
    sign: int = 1
    """-1 where it is raised."""


KINDS: Mapping[str, Kind] = {
    "dent": Kind("dent", DENT_DEPTH_MM),
    "bump": Kind("dent", DENT_DEPTH_MM, -1),
    "scratch": Kind("scratch", SCRATCH_DEPTH_MM),
}
"""A dent is round, with a low rim; a bump is a dent upside down; a scratch is a furrow with raised lips. Width grows
with the root of the depth: a dent of 0.1 mm is 1.2 mm wide, one of 0.4 mm 1.6 mm."""


@dataclass(frozen=True)
class Spot:
    """Where damage lies: its centre in mm, x right and y down from the middle of the region, and its direction."""

    x_mm: float
    y_mm: float
    turn_rad: float


@dataclass(frozen=True)
class Damage:
    """Damage of one kind and size at one spot."""

    kind: str
    size_mm: float
    """Its depth, or a bump's height."""
    spot: Spot

    def defect(self) -> Defect:
        """Return the damage for the simulator. Errors: ValueError for a size beyond the kind's largest."""
        kind, spot = KINDS[self.kind], self.spot
        return Defect(kind.shape, self.size_mm / kind.largest_mm, (spot.x_mm, spot.y_mm), spot.turn_rad)

    def relief(self, x_mm: F32, y_mm: F32) -> F32:
        """The change of the part's height in mm at points of the region, float32 like them."""
        changed = Damaged(lambda x, y: np.zeros_like(x), self.defect())(x_mm, y_mm)
        return np.asarray(KINDS[self.kind].sign * changed, np.float32)


def surroundings(damage: Damage, field: Field) -> Mask:
    """Return where a score map may show the damage, on it and within a cell of it, bool (h, w)."""
    damaged = np.abs(damage.relief(*grids(field))) > _EDGE_SHARE * damage.size_mm
    across, down = (2 * round(_OUTSIDE_MM / m) + 1 for m in field.mm_per_px)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (across, down))
    return np.asarray(cv2.dilate(damaged.astype(np.uint8), reach), np.bool_)
