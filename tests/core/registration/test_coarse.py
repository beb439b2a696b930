"""The coarse search: its candidates, and how near they come."""

import math

import numpy as np
import pytest
import turned_parts as parts

from edge.core.registration.coarse import CoarseSearch, shifts_alike
from edge.core.registration.pose import Pose


def test_no_candidate_lies_next_to_another() -> None:
    """A regular part fits nearly as well a pitch further on: each of the best is a pose of its own."""
    slopes = parts.slopes(parts.TEETH, Pose(), 64).astype(np.float32)
    found = CoarseSearch(slopes, 36).candidates(slopes, 6)
    places = [(pose.x_px, pose.y_px, round(pose.turn_rad * 18 / np.pi)) for pose, _ in found]

    assert len(found) > 1
    assert all(
        max(abs(a - b) for a, b in zip(one, other, strict=True)) > 1
        for k, one in enumerate(places)
        for other in places[:k]
    )
    assert round(found[0][1], 3) == 1.0
    assert math.hypot(found[0][0].x_px, found[0][0].y_px) < 0.1


def test_what_fits_much_worse_than_the_best_is_no_candidate() -> None:
    """There are fewer than asked for, and each fits at least four fifths as well as the best."""
    slopes = parts.slopes(parts.BLOCK, Pose(), 64).astype(np.float32)
    found = CoarseSearch(slopes, 36).candidates(slopes, 40)

    assert len(found) < 40
    assert min(match for _, match in found) >= 0.8 * found[0][1]


def test_a_pose_between_the_turns_and_the_cells_is_found_there() -> None:
    """Within 0.4 cells and a quarter of a step, where the nearest of each is half of one away."""
    slopes = parts.slopes(parts.BLOCK, Pose(), 64).astype(np.float32)
    true = Pose(3.5, -2.5, math.radians(45))
    ((pose, _), *_) = CoarseSearch(slopes, 36).candidates(
        parts.slopes(parts.BLOCK, true, 64).astype(np.float32), 8
    )
    rest = true.inverse().after(pose)

    assert max(abs(rest.x_px), abs(rest.y_px)) < 0.4
    assert abs(math.degrees(rest.turn_rad)) < 2.5


def test_a_part_is_found_from_one_side_of_the_field_to_the_other() -> None:
    """Learnt at the left, pressed 0.75 of the field further right: no shift wraps round to another."""
    ball = ((0.0, 0.0, 6.0, 6.0),)
    learnt, pressed = (parts.slopes(ball, Pose(x), 64).astype(np.float32) for x in (-24, 24))
    ((pose, _), *_) = CoarseSearch(learnt, 1).candidates(pressed, 8)

    assert pose.x_px == pytest.approx(48, abs=1.5)  # its flanks have left the field
    assert pose.y_px == pytest.approx(0, abs=1)


@pytest.mark.parametrize(("turn_rad", "pitch_px"), [(0.0, (10, 0)), (math.pi / 2, (0, 10))])
def test_teeth_look_alike_a_pitch_further_on(turn_rad: float, pitch_px: tuple[int, int]) -> None:
    """To the side or down; nothing agrees better than with itself."""
    slopes = parts.slopes(parts.TEETH, Pose(turn_rad=turn_rad), 64).astype(np.float32)
    (pose,) = shifts_alike(slopes, 1, 5.0, 0.9, 0.5)

    assert (abs(pose.x_px), abs(pose.y_px)) == pitch_px
    assert not shifts_alike(slopes, 1, 5.0, 1.001, 0.5)


@pytest.mark.parametrize(("part", "is_round"), [(parts.BALL, True), (parts.BAR, False), (parts.BLOCK, False)])
def test_a_ball_agrees_with_itself_at_any_turn(part: parts.Bumps, is_round: bool) -> None:
    """Its roundness is nearly 1; that of a part with a turn is far below."""
    slopes = parts.slopes(part, Pose(), 64).astype(np.float32)
    roundness = CoarseSearch(slopes, 36).roundness(slopes)

    assert roundness > 0.98 if is_round else roundness < 0.5
