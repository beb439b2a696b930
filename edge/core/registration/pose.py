"""Where a part lies under the gel, a shift and a turn from the pose in which the bank was learnt; and a press brought
to that pose, with its score map brought back."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import cv2
import numpy as np

from edge.core.arrays import F32, F64, U8, Mask

__all__ = ["Pose", "PoseUncertainty", "Registered", "depth_inside", "turn_slopes", "warp"]


@dataclass(frozen=True)
class Pose:
    """A point q of the bank lies at turn(q - centre) + centre + shift in the press.

    x_px, y_px: right and down.
    """

    x_px: float = 0.0
    y_px: float = 0.0
    turn_rad: float = 0.0
    """Clockwise in the picture, about the picture's centre."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x_px) and math.isfinite(self.y_px) and math.isfinite(self.turn_rad)):
            raise ValueError(f"a pose is finite, found {self}")

    def matrix(self, size: tuple[int, int]) -> F64:
        """The map from the bank's pixels to the press's, float64 (2, 3); pixel centres are integers. size: (w, h)."""
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        cx, cy = (size[0] - 1) / 2, (size[1] - 1) / 2
        return np.array(
            [
                [cos, -sin, cx + self.x_px - cos * cx + sin * cy],
                [sin, cos, cy + self.y_px - sin * cx - cos * cy],
            ]
        )

    def scale(self, factor: float) -> "Pose":
        """Scale the pose to pixels of another size."""
        return Pose(self.x_px * factor, self.y_px * factor, self.turn_rad)

    def after(self, first: "Pose") -> "Pose":
        """The pose that moves by `first`, then by this one."""
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return Pose(
            self.x_px + cos * first.x_px - sin * first.y_px,
            self.y_px + sin * first.x_px + cos * first.y_px,
            math.remainder(self.turn_rad + first.turn_rad, 2 * math.pi),
        )

    def inverse(self) -> "Pose":
        """The pose that moves back."""
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return Pose(-cos * self.x_px - sin * self.y_px, sin * self.x_px - cos * self.y_px, -self.turn_rad)


def warp(picture: F32, pose: Pose, flags: int = cv2.INTER_LINEAR) -> F32:
    """Move a picture of the press to where the bank sees it, float32 (h, w) or (h, w, c); 0 where it left the field."""
    size = picture.shape[1], picture.shape[0]
    moved = cv2.warpAffine(picture, pose.matrix(size), size, flags=flags | cv2.WARP_INVERSE_MAP)
    return np.asarray(moved, np.float32)


GEL_LIMIT_STEPS = 16
"""Limits of the gel are stored in sixteenths."""


def gel_limits_in_pose(limits: F32, pose: Pose) -> F32:
    """Move limits of the gel, (h, w), to where the bank sees them; 1 where they left the field."""
    return np.maximum(warp(limits, pose), np.float32(1))


def depth_inside(pose: Pose, size: tuple[int, int]) -> F32:
    """Measure how far inside the press's field each place of the bank lies, float32 (h, w), pixels; below 0 outside.

    size: (w, h) of the picture, whose outermost pixel centres are its border.
    """
    w, h = size
    (xx, xy, x0), (yx, yy, y0) = pose.matrix(size)
    column, row = np.arange(w), np.arange(h)[:, None]
    depth = np.full((h, w), np.inf, np.float32)
    for across, down, last in (((xx * column + x0), xy * row, w - 1), ((yx * column + y0), yy * row, h - 1)):
        at = across.astype(np.float32) + down.astype(np.float32)
        np.minimum(depth, at, out=depth)
        np.minimum(depth, np.float32(last) - at, out=depth)
    return depth


def turn_slopes(slopes: F32, pose: Pose) -> F32:
    """Move and turn slopes of the press to what the bank sees, float32 (h, w, 2)."""
    cos, sin = math.cos(pose.turn_rad), math.sin(pose.turn_rad)
    turn = np.array([[cos, sin], [-sin, cos]], np.float32)
    return np.asarray(cv2.transform(warp(slopes, pose), turn), np.float32)


@dataclass(frozen=True)
class PoseUncertainty:
    """One standard deviation."""

    x_px: float
    y_px: float
    turn_rad: float | None
    """None where the part has no turn."""


@dataclass(frozen=True, eq=False)
class Registered:
    """A press in the bank's pose."""

    rgb: U8
    """uint8 (h, w, 3), the mean nominal press where nothing is seen."""
    seen: Mask
    """bool (h, w): learnt places that lie in the press's field."""
    pose: Pose
    """Where the part lay."""
    uncertainty: PoseUncertainty
    match: float
    """Correlation with the mean nominal press, at most 1."""
    seen_share: float
    """The share of the part that lies in the field."""
    symmetry: int = 1
    """As `PartInPose.symmetry`."""
    refusal: str | None = None
    """Why the pose cannot be trusted; None where it can."""
    gel_limits: F32 | None = None
    """As `PartInPose.gel_limits`, in the bank's pose."""
    is_unique: bool = True
    """False where the part looks nearly the same at another turn, a pitch further on or along an edge: the press shows
    it as the bank has it, but which place of the part lies where is not known."""

    @property
    def turn_rad(self) -> float | None:
        """The least turn at which the part looks as it does; None where the part has no turn."""
        return math.remainder(self.pose.turn_rad, 2 * math.pi / self.symmetry) if self.symmetry else None

    def without(self, places: Mask) -> Self:
        """Return it as if it did not show these places of the press, bool (h, w)."""
        return replace(self, seen=self.seen & (warp(places.astype(np.float32), self.pose) == 0))

    def show_missing(self, score_map: F32, relief_map: F32) -> F32:
        """Return the map, in the bank's pose, with missing relief at its full height where places are seen.

        relief_map: what the map shows of it alone. The whole press lacks it, so it counts wherever it shows most: that
        may be a place which the bank does not know, or which has left the field.
        """
        height, seen = relief_map.max(), np.where(self.seen, relief_map, 0)
        peak = seen.max()
        shown = seen * (height / peak) if peak > 0 else np.where(self.seen, height, 0)
        return np.maximum(score_map, shown.astype(np.float32))

    def score(self, score_map: F32) -> float:
        """The highest score of a map in the bank's pose, of places that are seen, by the limits of the gel."""
        return float(self._weigh(score_map)[self.seen].max(initial=-math.inf))

    def _weigh(self, score_map: F32) -> F32:
        return score_map if self.gel_limits is None else score_map / self.gel_limits

    def in_press(self, score_map: F32) -> F32:
        """The map, float32 (h, w), where the part lies in the press, by the limits of the gel; unseen places have the
        lowest score of the map.

        The highest score keeps its value: interpolation would lower it.
        """
        score_map = self._weigh(score_map)
        lowest = np.float32(score_map.min())
        moved = warp(np.where(self.seen, score_map - lowest, 0).astype(np.float32), self.pose.inverse())
        if self.seen.any():
            peak = np.unravel_index(int(np.where(self.seen, score_map, -np.inf).argmax()), score_map.shape)
            x, y = self.pose.matrix((score_map.shape[1], score_map.shape[0])) @ np.array(
                [peak[1], peak[0], 1.0]
            )
            moved[self._inside(y, 0), self._inside(x, 1)] = score_map[peak] - lowest
        return moved + lowest

    def _inside(self, value: float, axis: int) -> int:
        return int(min(max(round(value), 0), self.seen.shape[axis] - 1))

    @cached_property
    def unseen_in_press(self) -> Mask:
        """Places of the press, bool (h, w), of which no bank was learnt."""
        return ~self.mask_in_press(self.seen)

    def mask_in_press(self, places: Mask) -> Mask:
        """Bring places of the bank's pose, bool (h, w), to where they lie in the press."""
        return np.asarray(warp(places.astype(np.float32), self.pose.inverse()) >= 0.5)
