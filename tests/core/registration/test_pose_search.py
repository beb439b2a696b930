"""The fast search finds what an exhaustive one finds, and what float64 gives."""

import math

import cv2
import numpy as np
import pytest
import turned_parts as parts

from edge.core.registration import registrar
from edge.core.registration.coarse import CoarseSearch
from edge.core.registration.fine import FineSearch
from edge.core.registration.pose import Pose, depth_inside, turn_slopes, warp
from edge.core.registration.registrar import PoseSearch, shrunk

SIDE = 112
POSES = (Pose(3.2, -7.1, 0.9), Pose(-14.3, 6.4, -2.6), Pose(9.7, 12.2, 3.0), Pose(0.4, -0.3, 0.02))


def _slopes(pose: Pose) -> np.ndarray:
    return parts.slopes(parts.BLOCK, pose, SIDE).astype(np.float32)


def _apart(one: Pose, other: Pose) -> tuple[float, float]:
    rest = one.inverse().after(other)
    return math.hypot(rest.x_px, rest.y_px), abs(math.degrees(rest.turn_rad))


@pytest.mark.parametrize("true", POSES)
def test_the_fast_search_finds_what_an_exhaustive_one_finds(true: Pose) -> None:
    """The coarse search at twice the turns and nearly twice the cells, then ten rounds: 0.01 px and 0.01 degrees."""
    part, press = _slopes(Pose()), _slopes(true)
    ((first, _), *_) = CoarseSearch(shrunk(part, SIDE // 2), 72).candidates(shrunk(press, SIDE // 2), 1)
    (slow,) = FineSearch(part).refine(press, [first.scale(2)], 10)

    assert max(_apart(slow, PoseSearch(part).find(press).pose)) < 0.01


def test_no_candidate_that_is_left_out_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    """A nearly round part fits nearly as well at every turn: it has the same pose as with all candidates rated."""
    rng = np.random.default_rng(0)
    noisy = [
        parts.slopes(parts.KEYED, pose, SIDE) + rng.normal(0, 0.6, (SIDE, SIDE, 2))
        for pose in parts.poses(24)
    ]
    search = PoseSearch(parts.slopes(parts.KEYED, Pose(), SIDE).astype(np.float32))

    def find_all() -> list[Pose]:
        return [search.find(slopes.astype(np.float32)).pose for slopes in noisy]

    fast = find_all()
    monkeypatch.setattr(registrar, "_RATED", registrar._CANDIDATES)
    assert max(max(_apart(one, other)) for one, other in zip(fast, find_all(), strict=True)) < 1e-3


def test_poses_refined_together_are_those_refined_alone() -> None:
    """Within what float32 sums in another order give; one of them shows half of the part only."""
    search, press = FineSearch(_slopes(Pose())), _slopes(POSES[0])
    near = [Pose(3.2 + x, -7.1 - x, 0.9 + turn) for x, turn in ((50.0, 0.02), (-1.0, 0.05), (1.5, -0.04))]
    together = search.refine(press, near, 2)
    alone = [search.refine(press, [pose], 2)[0] for pose in near]

    assert max(max(_apart(one, other)) for one, other in zip(together, alone, strict=True)) < 1e-3


def test_a_step_is_that_of_least_squares_in_float64() -> None:
    """The move of one round, from all places, agrees with numpy's least squares to a hundredth of a pixel."""
    side, move = 32, Pose(0.2, -0.15, 0.01)
    part = parts.slopes(parts.CROSS, Pose(), side)
    press = parts.slopes(parts.CROSS, move, side).astype(np.float32)
    (found,) = FineSearch(part.astype(np.float32)).refine(press, [Pose()], 1)

    steps = np.diag([1e-4, 1e-4, 1e-5])
    changes = [parts.slopes(parts.CROSS, Pose(*step), side) - part for step in steps]
    matrix = np.stack(
        [change.ravel() / step.sum() for change, step in zip(changes, steps, strict=True)], axis=1
    )
    expected = np.linalg.lstsq(matrix, (press - part).ravel(), rcond=None)[0]

    assert abs(found.x_px - expected[0]) < 0.02
    assert abs(found.y_px - expected[1]) < 0.02
    assert abs(found.turn_rad - expected[2]) < 2e-3


@pytest.mark.parametrize("pose", POSES)
def test_the_field_is_where_a_picture_of_ones_lies(pose: Pose) -> None:
    """The depth is at least 0 where a press's picture shows, and grows by one per pixel towards its middle."""
    depth = depth_inside(pose, (SIDE, SIDE - 20))
    seen = warp(np.ones((SIDE - 20, SIDE), np.float32), pose) > 0.99
    is_clear = np.abs(depth) > 0.05
    inner = cv2.erode((depth > 1).astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    down, right = np.gradient(depth)
    slope = np.hypot(down, right)[inner]

    np.testing.assert_array_equal(depth[is_clear] >= 0, seen[is_clear])
    assert np.quantile(slope, 0.9) == pytest.approx(1.0, abs=1e-3)


def test_agreement_counts_only_what_both_show() -> None:
    """A part that has left the field in part agrees fully in the rest, and the share inside is that of its energy."""
    part, pose = _slopes(Pose()), Pose(30.0, 0.0, 0.0)
    match, inside = FineSearch(part).agreement(_slopes(pose), pose)
    moved = turn_slopes(_slopes(pose), pose).astype(np.float64)
    energy = (_slopes(pose).astype(np.float64) ** 2).sum()

    assert match == pytest.approx(1.0, abs=1e-3)
    assert inside == pytest.approx((moved**2).sum() / energy, abs=1e-3)


def test_of_equal_poses_the_one_that_shows_more_of_the_press_is_found() -> None:
    """A rack that is longer than the field looks the same a tooth further on, where less of it is compared."""
    rack = tuple((12.0 * tooth, 0.0, 4.0, 5.0) for tooth in range(-20, 21))
    search = PoseSearch(parts.slopes(rack, Pose(), SIDE).astype(np.float32))
    rng = np.random.default_rng(3)
    clear = parts.slopes(rack, Pose(2.0, 1.0, 0.05), SIDE)
    found = [search.find((clear + rng.normal(0, 0.1, clear.shape)).astype(np.float32)).pose for _ in range(8)]

    assert max(abs(pose.x_px - 2.0) for pose in found) < 1.0
