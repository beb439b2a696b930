"""Deviations of a part that lies moved and turned under the gel: measured where it lies, against the good press of the
bundle laid there."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from lit_surface import MM_PER_PX, calibration, free_gel, grid, light

from edge.core.arrays import F64
from edge.core.contact.mask import Touch
from edge.core.defects import Deviation, find_defects
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import PROFILES
from edge.core.imaging.region import Region
from edge.core.press import JudgedFrame, Press
from edge.core.registration.pose import Pose, PoseUncertainty, Registered
from edge.model.deviations import DeviationMeter

DEPTH_MM, LENGTH_MM, WIDTH_MM = 0.12, 2.0, 1.0


def part(x: F64, y: F64) -> F64:
    """Three ribs of unequal height on a low dome: it looks otherwise wherever else it lies."""
    ribs = (0.3 * np.exp(-(((x - at) / 0.9) ** 2) - (y / 4) ** 2) for at in (-3.5, 0.5, 3.0))
    return 0.25 * np.exp(-(x * x + y * y) / 30) + sum(number * rib for number, rib in enumerate(ribs, 1)) / 2


def dent(x: F64, y: F64) -> F64:
    """Half of its depth is as long and as wide as said; beside a rib, along it."""
    return DEPTH_MM * 0.5 ** ((2 * (x + 1.4) / WIDTH_MM) ** 2 + (2 * (y - 1.2) / LENGTH_MM) ** 2)


def laid(pose: Pose) -> tuple[F64, F64]:
    """Where each place of the press lies on the part, mm."""
    x, y = grid()
    cos, sin = np.cos(pose.turn_rad), np.sin(pose.turn_rad)
    x, y = x - pose.x_px * MM_PER_PX, y - pose.y_px * MM_PER_PX
    return cos * x + sin * y, cos * y - sin * x


def bundle() -> Any:
    """What is asked of a bundle: one good press, in the bank's pose."""
    gel, good = free_gel(), light(part(*grid()), calibration())
    view = cv2.resize(gel.astype(np.float32), (160, 120), interpolation=cv2.INTER_AREA)
    return SimpleNamespace(
        digest="b",
        region=Region(0, 0, 320, 240),
        profile=PROFILES["cropped_lr"],
        free_view=view,
        free_region=gel,
        golden=[SimpleNamespace(rgb=good, what="a nominal press")],
        manifest=SimpleNamespace(dots=None, frame=(240, 320)),
        blind=None,
        prepare=lambda rgb: rgb,
    )


def measure(pose: Pose, registered: Pose) -> Deviation:
    """Measure the dent of a part that lies in a pose, registered in another one."""
    x, y = laid(pose)
    fitted, rgb = bundle(), light(part(x, y) - dent(x, y), calibration())
    seen = np.ones((240, 320), np.bool_)
    judged = JudgedFrame(CameraFrame(b"", 0, 0), Touch(0.3), fitted.free_view)
    press = Press(
        rgb=rgb,
        judged=judged,
        registered=Registered(rgb, seen, registered, PoseUncertainty(0, 0, 0), 1.0, 1.0),
    )
    (defect,) = find_defects((dent(x, y) / (DEPTH_MM / 2)).astype(np.float32), 1.0)
    measured = DeviationMeter(calibration()).measure(press, [defect], fitted)
    assert measured.reason == ""
    return measured.deviations[0]


@pytest.mark.parametrize("pose", [Pose(18, -11), Pose(turn_rad=0.5), Pose(-12, 15, -0.7)])
def test_place_and_size_follow_the_part(pose: Pose) -> None:
    """As where it was learnt, but for interpolation, and within what is stated; in no other pose does the good press
    fit around the dent."""
    found, learnt = measure(pose, pose), measure(Pose(), Pose())
    assert found.depth_mm == pytest.approx(learnt.depth_mm, abs=0.015)
    assert found.depth_mm == pytest.approx(DEPTH_MM, abs=found.depth_u95_mm)
    assert found.size_mm == pytest.approx(LENGTH_MM, abs=2 * MM_PER_PX)
    for wrong in (Pose(), pose.inverse()):
        other = measure(pose, wrong)
        assert (other.depth_u95_mm or 0) > 2.5 * (found.depth_u95_mm or 0)
