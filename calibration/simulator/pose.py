"""The part's place under the gel, and how much a press differs from the robot's command."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Protocol

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked

from calibration.simulator.field_of_view import Field as View
from calibration.simulator.field_of_view import grids
from edge.core.arrays import F32

__all__ = ["FIXTURE", "HeightField", "Jitter", "Pose", "contact", "partial_contact", "pose_jitter", "sample"]


class HeightField(Protocol):
    """A part: its height in mm at points of its own plane, 0 at its highest nominal point, negative below."""

    def __call__(self, x_mm: F32, y_mm: F32, /) -> F32: ...


@dataclass(frozen=True)
class Pose:
    """The part's place. shift: mm in the picture's axes. turn: radians, clockwise in the picture."""

    shift_mm: tuple[float, float] = (0.0, 0.0)
    turn_rad: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    """mm of height per mm along the picture's x and y."""
    depth_factor: float = 1.0
    """On the commanded depth."""


@checked(frozen=True, config=ConfigDict(extra="forbid"))
class Jitter:
    """Standard deviations of a press about its command."""

    shift_mm: Annotated[float, Field(ge=0, le=3)]
    turn_deg: Annotated[float, Field(ge=0, le=45)]
    tilt_deg: Annotated[float, Field(ge=0, le=5)]
    # More would lose contact.
    depth_fraction: Annotated[float, Field(ge=0, le=0.3)]


FIXTURE = Jitter(0.12, 0.7, 0.3, 0.05)
"""A fixture repeats a part's place within about 0.1 mm."""


def pose_jitter(pose: Pose, jitter: Jitter, rng: np.random.Generator) -> Pose:
    """The pose of one press: shift, turn, tilt and depth, each normal about the command, cut at 2.5 sd.

    Sizes are assumed from the repeatability of robots and hands, not measured on this sensor.
    """
    dx, dy, turn, tx, ty, depth = np.clip(rng.standard_normal(6), -2.5, 2.5).tolist()
    tilt = math.tan(math.radians(jitter.tilt_deg))
    return Pose(
        (pose.shift_mm[0] + dx * jitter.shift_mm, pose.shift_mm[1] + dy * jitter.shift_mm),
        pose.turn_rad + math.radians(turn * jitter.turn_deg),
        (pose.tilt[0] + tx * tilt, pose.tilt[1] + ty * tilt),
        pose.depth_factor * (1 + depth * jitter.depth_fraction),
    )


def partial_contact(pose: Pose, rng: np.random.Generator) -> Pose:
    """Tilt a pose by 0.5 to 2 degrees to one side, so that the other side loses contact.

    Real thread imprints taper off towards one end in this way (seen on public frames of three threads).
    """
    lean = math.tan(math.radians(rng.uniform(0.5, 2.0)))
    side = rng.uniform(0.0, 2 * math.pi)
    return replace(pose, tilt=(pose.tilt[0] + lean * math.cos(side), pose.tilt[1] + lean * math.sin(side)))


def sample(part: HeightField, pose: Pose, field: View) -> F32:
    """The part's height over the field in mm, float32 (h, w), in this pose and before any press."""
    x, y = grids(field)
    x = x - np.float32(pose.shift_mm[0])
    y = y - np.float32(pose.shift_mm[1])
    cos, sin = np.float32(math.cos(pose.turn_rad)), np.float32(math.sin(pose.turn_rad))
    height = part(cos * x + sin * y, cos * y - sin * x)
    if pose.tilt != (0.0, 0.0):
        height = height + np.float32(pose.tilt[0]) * x + np.float32(pose.tilt[1]) * y
    return np.asarray(height, dtype=np.float32)


def contact(height: F32, depth_mm: float) -> F32:
    """Compute how deep the rigid part would enter an infinitely soft gel, in mm: the obstacle for the gel."""
    return np.asarray(np.maximum(height + np.float32(depth_mm), np.float32(0)), dtype=np.float32)
