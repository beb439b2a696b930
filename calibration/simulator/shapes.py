"""The basic solids of parts: signed distances and edges, in mm."""

import numpy as np
from numpy.typing import ArrayLike

from edge.core.arrays import F32

__all__ = ["FLOOR_MM", "box", "disc", "f32", "plateau", "ramp", "rotate"]

# The height around and below a part: far below any press.
FLOOR_MM = np.float32(-4.0)


def f32(values: ArrayLike) -> F32:
    """The values as float32, where NumPy's type stubs do not know the precision."""
    return np.asarray(values, dtype=np.float32)


def rotate(x: F32, y: F32, angle_rad: float) -> tuple[F32, F32]:
    """The points' coordinates in axes turned by the angle."""
    cos, sin = np.float32(np.cos(angle_rad)), np.float32(np.sin(angle_rad))
    return cos * x + sin * y, cos * y - sin * x


def box(x: F32, y: F32, half_x: float, half_y: float, corner: float = 0.0) -> F32:
    """Signed distance to a rectangle about the origin, negative inside, corners rounded by a radius."""
    # In place: at 1280x720, temporaries cost more than the arithmetic.
    dx, dy = np.abs(x), np.abs(y)
    dx -= np.float32(half_x - corner)
    dy -= np.float32(half_y - corner)
    outside, other = np.maximum(dx, 0), np.maximum(dy, 0)
    outside *= outside
    other *= other
    outside += other
    np.sqrt(outside, out=outside)
    inside = np.maximum(dx, dy, out=dx)
    outside += np.minimum(inside, 0, out=inside)
    outside -= np.float32(corner)
    return outside


def disc(x: F32, y: F32, radius: float) -> F32:
    """Signed distance to a circle about the origin, negative inside."""
    return f32(np.sqrt(x * x + y * y) - np.float32(radius))


def ramp(t: ArrayLike) -> F32:
    """0 below 0, 1 above 1, and a smooth rise between: the section of a broken edge."""
    within = np.clip(f32(t), 0, 1)
    curve = np.float32(3) - 2 * within
    within *= within
    curve *= within
    return curve


def plateau(distance: F32, top: float, below: ArrayLike, chamfer: float = 0.12) -> F32:
    """Height `top` inside a shape, `below` outside it, and a broken edge of the chamfer's width inside the outline."""
    edge = ramp(-distance / np.float32(chamfer))
    low = f32(below)
    # The wall drops vertically below the chamfer: the gel touches only the chamfer.
    inside = np.float32(top) - np.float32(min(chamfer, 0.25)) * (1 - edge)
    return f32(np.where(distance < 0, np.maximum(inside, low), low))
