"""How presses of a part that nearly looks the same at several turns are turned alike."""

import math

import numpy as np
import turned_parts as parts

from calibration.fitting.pose.turns import agree_on_turns
from edge.core.registration.pose import Pose

THIRD = Pose(turn_rad=2 * math.pi / 3)
(_X, _Y, _RADIUS, _HEIGHT), *_OTHERS = parts.ring(3)
KEYED: parts.Bumps = ((_X, _Y, _RADIUS, 1.1 * _HEIGHT), *_OTHERS)
"""Three like teeth, one a little higher."""


def turn(part: parts.Bumps, n: int = 12) -> tuple[list[Pose], list[Pose] | None]:
    """Turn presses alike that lie anywhere, each found at one of three turns by chance; give its true pose too."""
    true, rng = parts.poses(n), np.random.default_rng(3)
    slopes = [
        (parts.slopes(part, pose) + rng.normal(0, 0.01, (parts.SIDE, parts.SIDE, 2))).astype(np.float32)
        for pose in true
    ]
    found = list[Pose]()
    for pose, steps in zip(true, rng.integers(0, 3, n), strict=True):
        for _ in range(steps):
            pose = pose.after(THIRD)
        found.append(pose)
    return true, agree_on_turns(slopes, found, THIRD, 3)


def test_presses_of_three_like_teeth_of_which_one_is_higher_are_turned_alike() -> None:
    true, turned = turn(KEYED)

    assert turned is not None
    apart = np.array([one.turn_rad - other.turn_rad for one, other in zip(true, turned, strict=True)])
    assert np.abs(np.exp(1j * apart) - np.exp(1j * apart[0])).max() < 1e-6


def test_presses_that_look_the_same_at_each_turn_keep_their_turns() -> None:
    assert turn(parts.ring(3))[1] is None


def test_presses_that_are_turned_alike_keep_their_turns() -> None:
    poses = parts.poses(12)
    slopes = [parts.slopes(KEYED, pose).astype(np.float32) for pose in poses]
    assert agree_on_turns(slopes, poses, THIRD, 3) is None
