"""Presses of parts at any pose, from formulas: an oracle for registration that warps no picture.

A part is a sum of smooth bumps, so its slopes are known everywhere in float64. A sensor shows slopes by one 3 x 2
matrix under a light that falls towards the rim.
"""

import math
from collections.abc import Sequence

import numpy as np

from edge.core.arrays import F64, U8
from edge.core.registration.pose import Pose

Bumps = Sequence[tuple[float, float, float, float]]
"""Bumps of a part: x, y from its middle, radius, all in pixels, and height."""

SIDE = 128
# Levels of red, green and blue per unit of the slopes along x and y: as measured on a public Mini, rounded.
SENSOR = np.array([[-10.0, -95.0], [60.0, 8.0], [12.0, 65.0]])

MIDDLE = Pose()

BLOCK: Bumps = (
    (-20, -12, 6, 8),
    (14, -18, 5, -6),
    (22, 10, 7, 9),
    (-8, 16, 4, 5),
    (2, 0, 9, 7),
    (-26, 20, 5, -5),
)
OTHER: Bumps = ((-15, 20, 5, 8), (0, -22, 4, 6), (5, 15, 12, -9), (25, -5, 6, 7))


def ring(n: int, radius: float = 7.0) -> Bumps:
    """n equal bumps around the middle: a part that looks the same n times in a full turn."""
    return tuple(
        (26 * math.cos(2 * math.pi * k / n), 26 * math.sin(2 * math.pi * k / n), radius, 8) for k in range(n)
    )


CROSS = ring(4)
# Nearly round: only a low bump says how it is turned.
KEYED: Bumps = (*ring(36, 4.0), (12.0, 0.0, 5.0, 8.0))
TEETH: Bumps = (*((10.0 * k - 40, 0.0, 3.0, 5.0) for k in range(9)), (40.0, 7.0, 3.0, 4.0))
BAR: Bumps = tuple((3.0 * k - 30, 0.0, 4.0, 5.0) for k in range(21))
# Both go on beyond the field.
GRID: Bumps = tuple((24.0 * k, 24.0 * row, 6.0, 8.0) for k in range(-5, 6) for row in range(-5, 6))
EDGE: Bumps = tuple((0.0, 4.0 * k, 6.0, 5.0) for k in range(-40, 41))
BALL: Bumps = ((0, 0, 14, 12),)


def slopes(part: Bumps, pose: Pose, side: int = SIDE) -> F64:
    """Of a part in this pose, (side, side, 2), right and down."""
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    cos, sin = math.cos(pose.turn_rad), math.sin(pose.turn_rad)
    found = np.zeros((side, side, 2))
    for bx, by, radius, height in part:
        dx = x - (cos * bx - sin * by + pose.x_px)
        dy = y - (sin * bx + cos * by + pose.y_px)
        bump = height * np.exp(-(dx**2 + dy**2) / (2 * radius**2)) / radius**2
        found -= bump[..., None] * np.stack([dx, dy], axis=-1)
    return found


def _light(side: int) -> F64:
    y, x = (np.mgrid[:side, :side] - (side - 1) / 2) / side
    return np.stack([1 - 0.9 * (x**2 + y**2), 1 - 0.5 * (x**2 + y**2), 1 - 0.7 * (x**2 + y**2)], axis=-1)


def free_gel(side: int = SIDE) -> U8:
    """The gel that nothing touches, uint8 (side, side, 3)."""
    return np.rint(_light(side) * [120.0, 115.0, 130.0]).astype(np.uint8)


def press(
    part: Bumps,
    pose: Pose = MIDDLE,
    noise: float = 1.5,
    seed: int = 0,
    gain: float = 1.0,
) -> U8:
    """A press, uint8 (128, 128, 3). noise: levels. gain: of the light, 1 that of the free gel."""
    light = _light(SIDE) * ([120.0, 115.0, 130.0] + slopes(part, pose) @ SENSOR.T)
    grain = np.random.default_rng(seed).normal(0, noise, light.shape)
    return np.clip(np.rint(gain * light + grain), 0, 255).astype(np.uint8)


def poses(n: int, seed: int = 1, shift_px: float = 18.0, turn_rad: float = math.pi) -> list[Pose]:
    """Where parts lie that a hand puts down."""
    rng = np.random.default_rng(seed)
    return [
        Pose(*rng.uniform(-shift_px, shift_px, 2).tolist(), float(rng.uniform(-turn_rad, turn_rad)))
        for _ in range(n)
    ]


def anywhere(part: Bumps, n: int, seed: int = 1, **ranges: float) -> tuple[list[Pose], U8]:
    """n presses of a part anywhere: their poses, and uint8 (n, 128, 128, 3)."""
    found = poses(n, seed, **ranges)
    return found, np.stack([press(part, pose, seed=seed + k) for k, pose in enumerate(found)])
