"""How often simulated parts look the same in a full turn, pressed by a hand: anywhere, tilted, to different depths."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from calibration.fitting.pose.pose_decision import PoseChoice
from calibration.fitting.pose.registration import LearntPose, learn_pose
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import Jitter, Pose
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import Renderer
from calibration.simulator.streams import Streams
from edge.core.arrays import F32, F64, U8
from edge.core.imaging.region import Region
from edge.core.registration.registrar import Registrar

Shape = Callable[[F32, F32], F32]
STEEP = 4.0
"""Of flanks, which end 1 mm below the face."""


def face(outside_mm: F32) -> F32:
    """The height of a flat face whose end is this far away, below 0 inside."""
    return np.asarray(np.clip(-STEEP * outside_mm, -1, 0), np.float32)


def bar(x: F32, y: F32) -> F32:
    """A bar with a hole at each end."""
    holes = (face(0.7 - np.hypot(x - at, y)) for at in (-2.2, 2.2))
    return np.minimum.reduce([face(np.maximum(np.abs(x) - 4, np.abs(y) - 1.6)), *holes])


def nut(sides: int) -> Shape:
    """A plate of equal sides with a hole."""
    step = 2 * math.pi / sides

    def height(x: F32, y: F32) -> F32:
        radius, angle = np.hypot(x, y), np.arctan2(y, x)
        out = radius * np.cos(np.mod(angle, step) - step / 2) - 3.4
        return np.minimum(face(out), face(1.5 - radius))

    return height


def flange(x: F32, y: F32) -> F32:
    """A disc with four holes."""
    holes = (face(0.8 - np.hypot(x - dx, y - dy)) for dx, dy in ((2.8, 0), (0, 2.8), (-2.8, 0), (0, -2.8)))
    return np.minimum.reduce([face(np.hypot(x, y) - 4.5), *holes])


def washer(x: F32, y: F32) -> F32:
    radius = np.hypot(x, y)
    return np.minimum(face(radius - 4), face(1.5 - radius))


SLOTTED = random_part(np.random.default_rng([99, 7]))
"""It nearly looks the same turned by half: its tilt hides by how much it does not."""
REGION = Region.centre(LR.size)


def press(
    part: Shape, count: int, depth_mm: float, away_mm: float, turn_rad: float, seed: int
) -> tuple[F64, U8, U8]:
    """Press a part that a hand lays this far away, turned by up to so much: the turns, the presses, the free gel."""
    streams = Streams(seed)
    gel, poses = Renderer(LR, jitter=Jitter(0.0, 0.0, 1.0, 0.1), streams=streams), list[Pose]()
    for k in range(count):
        share, towards, turn = streams("anywhere", k).uniform((0, 0, -1), (1, 2 * math.pi, 1)).tolist()
        away = away_mm * math.sqrt(share)
        poses.append(Pose((away * math.cos(towards), away * math.sin(towards)), turn_rad * turn))
    frames = [REGION.crop(gel.press(part, depth_mm, (k,), pose)) for k, pose in enumerate(poses)]
    return np.array([pose.turn_rad for pose in poses]), np.stack(frames), REGION.crop(gel.free_gel())


def apart_rad(learnt: LearntPose, turns_rad: F64) -> float:
    """Measure by how much presses are turned otherwise than the first, but for steps of the symmetry."""
    found = np.array([one.pose.turn_rad for one in learnt.registered]) - turns_rad
    times = learnt.part.symmetry
    return float(np.abs(np.angle(np.exp(1j * times * (found - found[0])))).max()) / times


def warnings(learnt: LearntPose) -> list[str]:
    return PoseChoice(learnt).find_warnings([""] * len(learnt.registered))


@pytest.mark.parametrize(
    ("part", "symmetry"),
    [
        (bar, 2),
        (nut(3), 3),
        (flange, 4),
        pytest.param(nut(4), 4, marks=pytest.mark.lab),
        (nut(6), 6),
        (washer, 0),
    ],
    ids=["2", "3", "4", "4 without holes", "6", "full"],
)
def test_a_part_that_looks_the_same_at_several_turns_is_known_from_its_presses(
    part: Shape, symmetry: int
) -> None:
    """Their tilts, which differ from turn to turn, are no asymmetry of the part, and there is nothing to warn of."""
    turns_rad, frames, free = press(part, 12, 0.35, 1.8, math.pi, 81)
    learnt = learn_pose(frames, free)

    assert (learnt.part.symmetry, learnt.part.nearly) == (symmetry, 1)
    assert not warnings(learnt)
    if symmetry:
        assert apart_rad(learnt, turns_rad) < math.radians(5)


def test_of_a_part_whose_tilt_hides_its_turn_it_is_said_that_no_press_tells_it() -> None:
    """Half of the presses would be turned wrong: the part is compared as if it looked the same twice."""
    turns_rad, frames, free = press(SLOTTED, 20, 0.4, 2.5, math.pi, 11)
    learnt = learn_pose(frames, free)

    assert (learnt.part.symmetry, learnt.part.nearly) == (2, 2)
    assert apart_rad(learnt, turns_rad) < math.radians(5)
    (said,) = warnings(learnt)
    assert said.startswith(
        "not proven: the part nearly looks the same 2 times in a full turn, and none of 20 presses tells at which"
    )
    assert "hold the part at one turn, or press at least 24" in said


def test_a_part_that_nearly_looks_the_same_keeps_the_turn_at_which_it_is_held() -> None:
    """Its tilt turns no further press either, and nothing is to be said."""
    turns_rad, frames, free = press(SLOTTED, 32, 0.4, 2.5, 0.05, 11)
    learnt = learn_pose(frames[:20], free)

    assert (learnt.part.symmetry, learnt.part.is_held) == (1, True)
    assert not warnings(learnt)
    registrar = Registrar(learnt.part)
    found = np.array([registrar.register(rgb).pose.turn_rad for rgb in frames]) - turns_rad
    assert np.abs(found - found[0]).max() < math.radians(5)


@pytest.mark.lab
def test_presses_of_a_nearly_symmetric_part_are_turned_alike() -> None:
    """24 presses of a connector with three pins that lies anywhere; found one by one, 11 are turned by a wrong 120
    degrees, as a registrar turns some that compares all places alike. Where a press hardly tells its turn that is said.
    """
    part, depth_mm = PARTS["PZ2"].positions["pos1"], PARTS["PZ2"].depth_mm
    turns_rad, frames, free = press(part, 24, depth_mm, 2.5, math.pi, 14)
    learnt = learn_pose(frames, free)

    assert (learnt.part.symmetry, learnt.part.nearly) == (1, 3)
    assert apart_rad(learnt, turns_rad) < math.radians(5)
    (said,) = warnings(learnt)
    assert (
        "turn of presses is not sure: 1 of 24 presses ('') agree nearly as well turned by 120 degrees" in said
    )
