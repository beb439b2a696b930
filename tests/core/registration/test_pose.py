"""Poses as a group: what they compose to, and where they move a place."""

import math

import numpy as np
import pytest

from edge.core.arrays import Mask
from edge.core.registration.pose import Pose, PoseUncertainty, Registered, gel_limits_in_pose, warp


def test_a_pose_after_its_inverse_is_none() -> None:
    """Moving there and back gives the first place."""
    pose = Pose(7.0, -3.0, 2.5)
    back = pose.after(pose.inverse())

    np.testing.assert_allclose([back.x_px, back.y_px, back.turn_rad], 0, atol=1e-12)


def test_poses_compose_like_their_matrices() -> None:
    """A place moved by one pose and then the other lies where the composed pose moves it."""
    first, then = Pose(4.0, 9.0, 0.7), Pose(-6.0, 2.0, -1.9)
    one, other, both = (
        np.vstack([pose.matrix((64, 48)), [0, 0, 1]]) for pose in (first, then, then.after(first))
    )

    np.testing.assert_allclose(other @ one, both, atol=1e-9)


def test_a_quarter_turn_moves_the_right_side_down() -> None:
    """Worked by hand: clockwise in the picture, about the middle."""
    turned = Pose(turn_rad=math.pi / 2).matrix((5, 5)) @ [4, 2, 1]

    np.testing.assert_allclose(turned, [2, 4], atol=1e-12)


def test_a_press_is_seen_where_the_bank_has_it() -> None:
    """A place that lies 3 px to the right in the press is brought back; what left the field is 0."""
    picture = np.zeros((9, 9), np.float32)
    picture[4, 7] = 1
    moved = warp(picture + 1, Pose(3.0, 0.0))

    assert moved[4, 4] == 2
    assert (moved[:, 7:] == 0).all()


def test_a_pose_is_finite() -> None:
    """A pose that was not found is no pose."""
    with pytest.raises(ValueError, match="finite"):
        Pose(math.nan, 0.0, 0.0)


def placed(pose: Pose, seen: Mask) -> Registered:
    rgb = np.zeros((*seen.shape, 3), np.uint8)
    return Registered(rgb, seen, pose, PoseUncertainty(0.1, 0.1, None), match=0.9, seen_share=1.0)


def test_limits_of_the_gel_are_one_where_they_left_the_field() -> None:
    """A place that is judged less strictly moves with the part; what comes in is judged by the limit itself."""
    limits = np.full((9, 9), 2, np.float32)
    moved = gel_limits_in_pose(limits, Pose(3.0, 0.0))
    assert (moved[:, :6] == 2).all()
    assert (moved[:, 7:] == 1).all()


def test_places_of_the_press_that_are_left_out_are_not_seen() -> None:
    """They are of the press: in the bank's pose they lie where the part has moved from."""
    hidden = np.zeros((9, 9), bool)
    hidden[4, 7] = True
    left = placed(Pose(3.0, 0.0), np.ones((9, 9), bool)).without(hidden).seen
    assert np.argwhere(~left).tolist() == [[4, 4]]


def test_missing_relief_counts_at_its_full_height_where_places_are_seen() -> None:
    """Highest at a place that is not seen, the map shows it at the one that is; without any, at each place that is."""
    seen = np.array([[True, True, False]])
    press, score = placed(Pose(), seen), np.full((1, 3), 0.5, np.float32)
    relief = np.array([[0.0, 2.0, 4.0]], np.float32)
    assert press.show_missing(score, relief).tolist() == [[0.5, 4.0, 0.5]]
    relief[0, 1] = 0
    assert press.show_missing(score, relief).tolist() == [[4.0, 4.0, 0.5]]
