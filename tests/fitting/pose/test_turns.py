"""How presses of a part that nearly looks the same at several turns are turned alike."""

import math

import numpy as np
import pytest
import turned_parts as parts

from calibration.fitting.pose.turns import agree_on_turns, find_asymmetry
from edge.core.registration.pose import Pose

THIRD = Pose(turn_rad=2 * math.pi / 3)
(_X, _Y, _RADIUS, _HEIGHT), *_OTHERS = parts.ring(3)
KEYED: parts.Bumps = ((_X, _Y, _RADIUS, 1.1 * _HEIGHT), *_OTHERS)
"""Three like teeth, one a little higher."""


def turn(part: parts.Bumps, n: int = 12) -> tuple[list[Pose], list[Pose], bool]:
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
    return true, *agree_on_turns(slopes, found, THIRD, 3)


def test_presses_of_three_like_teeth_of_which_one_is_higher_are_turned_alike() -> None:
    true, turned, is_clear = turn(KEYED)

    assert is_clear
    apart = np.array([one.turn_rad - other.turn_rad for one, other in zip(true, turned, strict=True)])
    assert np.abs(np.exp(1j * apart) - np.exp(1j * apart[0])).max() < 1e-6


def test_turns_of_presses_that_look_the_same_at_each_are_not_clear() -> None:
    *_, is_clear = turn(parts.ring(3))
    assert not is_clear


def test_presses_that_are_turned_alike_keep_their_turns() -> None:
    poses = parts.poses(12)
    slopes = [parts.slopes(KEYED, pose).astype(np.float32) for pose in poses]
    assert agree_on_turns(slopes, poses, THIRD, 3) == (poses, True)


@pytest.mark.parametrize(
    ("part", "share"), [(parts.ring(3), 0.0), (KEYED, 0.0), ((*parts.ring(3), (8.0, 12.0, 3.0, 4.0)), 0.054)]
)
@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_what_differs_from_the_part_turned_is_no_tilt_of_it(
    part: parts.Bumps, share: float, tilt: float
) -> None:
    """A tilt makes teeth on one side higher, and one higher tooth of three is no other. The relief of a bump goes with
    its height squared: two thirds of that of a mark differ from the mean of three turns."""
    across = np.linspace(-1, 1, parts.SIDE)[:, None]
    slopes = (parts.slopes(part, Pose()) * (1 + tilt * across)).astype(np.float32)
    assert find_asymmetry(slopes, THIRD, 3) == pytest.approx(share, rel=0.1, abs=3e-3)
