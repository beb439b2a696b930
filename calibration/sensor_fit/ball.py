"""A ball in the gel: where it was pressed, found in the picture without a start from the user."""

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.simulator.field_of_view import LR
from calibration.simulator.shapes import f32
from edge.core.arrays import F32, F64, Mask

__all__ = ["Ball", "Circle", "ball_height", "find_circle"]

# The contact is where the change is above this share of its strongest, and above what noise and drift reach.
_SHARE, _LEAST_LEVELS, _STRONGEST = 0.35, 10.0, 99.5
_SMOOTH_PX, _CLOSE_PX = 2.0, 9
# The gel lifts around the ball, so the circle that is seen is larger than the one that touches (measured on 105 real
# presses).
_TOUCHING = 0.85


@dataclass(frozen=True)
class Ball:
    """One press of a ball: its axis in mm from the picture's centre, and how deep its pole is in the gel, in mm."""

    x_mm: float
    y_mm: float
    depth_mm: float

    def contact_radius_mm(self, ball_radius_mm: float) -> float:
        """Return the radius of the circle in which the ball stands above the free gel's surface."""
        return float(np.sqrt(max(2 * ball_radius_mm * self.depth_mm - self.depth_mm**2, 0.0)))


@dataclass(frozen=True)
class Circle:
    """The outline of a change in a picture, in pixels."""

    x: float
    y: float
    radius: float

    def is_inside(self, size: tuple[int, int]) -> bool:
        """Say whether the touching part lies in a picture of (width, height)."""
        reach = _TOUCHING * self.radius
        return reach <= self.x <= size[0] - reach and reach <= self.y <= size[1] - reach

    @property
    def touching_mm(self) -> float:
        """The radius of the contact itself."""
        return _TOUCHING * self.radius * LR.mm_per_px[0]

    def ball(self, ball_radius_mm: float) -> Ball:
        """The press that leaves this circle, roughly."""
        mm, reach = LR.mm_per_px[0], min(self.touching_mm, 0.95 * ball_radius_mm)
        cap = ball_radius_mm - float(np.sqrt(ball_radius_mm**2 - reach**2))
        return Ball((self.x + 0.5 - LR.size[0] / 2) * mm, (self.y + 0.5 - LR.size[1] / 2) * mm, cap)


def find_circle(change: F32, ignored: Mask | None = None) -> Circle | None:
    """The circle of the largest change, None where nothing changes.

    change: float32 (3, h, w), a press without the free gel. ignored: bool (h, w), such as marker dots.
    """
    strength = np.linalg.norm(change, axis=0).astype(np.float32)
    if ignored is not None:
        strength[ignored] = 0
    smooth = cv2.GaussianBlur(strength, (0, 0), _SMOOTH_PX)
    limit = max(_LEAST_LEVELS, _SHARE * float(np.percentile(smooth, _STRONGEST)))
    changed = (smooth > limit).astype(np.uint8)
    closed = cv2.morphologyEx(changed, cv2.MORPH_CLOSE, np.ones((_CLOSE_PX, _CLOSE_PX), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(outlines, key=cv2.contourArea, default=None)
    return None if largest is None or len(largest) < 8 else _through(largest[:, 0].astype(np.float64))


def _through(points: F64) -> Circle:
    """The least-squares circle through points (n, 2), by Kasa's linear form."""
    columns = np.column_stack([2 * points, np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(columns, (points**2).sum(axis=1), rcond=None)[0]
    return Circle(float(x), float(y), float(np.sqrt(max(rest + x * x + y * y, 0.0))))


def ball_height(ball: Ball, ball_radius_mm: float, x: F32, y: F32) -> F32:
    """Return how far the ball stands above the free gel, mm, float32 as x and y (mm from the picture's centre)."""
    squared = (x - np.float32(ball.x_mm)) ** 2 + (y - np.float32(ball.y_mm)) ** 2
    rise = np.sqrt(np.maximum(np.float32(ball_radius_mm**2) - squared, 0))
    return f32(np.maximum(rise - np.float32(ball_radius_mm - ball.depth_mm), 0))
