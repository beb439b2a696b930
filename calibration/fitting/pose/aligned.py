"""Presses in their common pose, and their mean."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edge.core.arrays import F32, F64, Mask
from edge.core.registration.colours import SlopeColours
from edge.core.registration.pose import Pose
from edge.core.registration.registrar import in_pose

__all__ = ["Aligned", "mean_press", "mean_slopes"]

# A place of the bank is learnt where at least this share of the presses shows it.
_LEARNT_SHARE = 0.35


@dataclass(frozen=True, eq=False)
class Aligned:
    """Presses in their common pose."""

    poses: Sequence[Pose]
    """In pixels of the shrunk presses."""
    typical: float
    """How well a press agrees with the mean of others, in the median."""
    symmetry: int
    """As `PartInPose.symmetry`."""
    colours: SlopeColours
    is_held: bool = False
    """Whether presses of a part that repeats itself have one turn among those that look the same."""
    doubts: frozenset[int] = frozenset()
    """How often the part may look the same in a full turn, as `symmetry`: presses may lie turned by so much."""
    nearly: int = 1
    """As `PartInPose.nearly`."""
    together: "Aligned | None" = None
    """The same presses turned together."""

    @property
    def turns(self) -> F64:
        return np.array([pose.turn_rad for pose in self.poses])


def mean_press(added: Sequence[F32], poses: Sequence[Pose], colours: SlopeColours) -> tuple[F32, Mask]:
    """The mean of what presses add in the bank's pose, and the places that enough of them show."""
    total = np.zeros_like(added[0])
    count = np.zeros(total.shape[:2], np.float32)
    for added_light, pose in zip(added, poses, strict=True):
        moved, seen = in_pose(added_light, pose, colours)
        total += cv2.copyTo(moved, seen.view(np.uint8))  # 0 elsewhere
        count += seen
    mean = np.asarray(total / np.maximum(count, 1)[..., None], np.float32)
    return mean, count >= _LEARNT_SHARE * len(added)


def mean_slopes(small: Sequence[F32], aligned: Aligned) -> F32:
    """Compute the slopes of the mean press, float32 (h, w, 2)."""
    mean, learnt = mean_press(small, aligned.poses, aligned.colours)
    return aligned.colours.slopes(mean * learnt[..., None])
