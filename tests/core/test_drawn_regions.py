"""Regions that a person draws: what they weigh, worked by hand, and what they refuse."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from edge.core.drawn_regions import DrawnRegion, DrawnRegions, find_blind, region_at, weigh_places
from edge.core.registration.pose import Pose

FRAME, MM = (40, 60), (0.1, 0.1)
"""A field of 6.0 x 4.0 mm."""


def square(name: str, kind: str, x: float, y: float, side: float, factor: float = 1.0) -> DrawnRegion:
    corners = ((x, y), (x + side, y), (x + side, y + side), (x, y + side))
    return DrawnRegion(name, kind, corners, factor)  # type: ignore[arg-type]


def test_each_kind_has_its_weight() -> None:
    """1 mm is ten pixels; ignored is 0, stricter its factor, and nothing else changes."""
    weights = weigh_places(
        [square("logo", "ignore", 1, 1, 1), square("seam", "stricter", 3, 2, 1, 1.5)], FRAME, MM
    )
    assert weights[15, 15] == 0
    assert weights[25, 35] == np.float32(1.5)
    assert np.count_nonzero(weights == 0) == pytest.approx(100, abs=25)
    assert np.count_nonzero(weights == 1) == pytest.approx(2400 - 200, abs=50)


def test_judge_leaves_everything_else_out_and_ignore_decides() -> None:
    """Two places to judge, one of them stricter; a logo inside stays ignored."""
    weights = weigh_places(
        [
            square("seam", "stricter", 4, 1, 1, 2.0),
            square("face", "judge", 1, 1, 2),
            square("logo", "ignore", 1.5, 1.5, 0.5),
        ],
        FRAME,
        MM,
    )
    assert [weights[y, x] for y, x in ((35, 5), (12, 12), (17, 17), (15, 45))] == [0, 1, 0, 2]
    blind = find_blind(weights)
    assert blind is not None
    assert blind[35, 5]
    assert find_blind(weigh_places([square("seam", "stricter", 4, 1, 1, 2.0)], FRAME, MM)) is None


def test_the_region_of_a_place_is_the_smallest_around_it() -> None:
    regions = [square("face", "judge", 1, 1, 2), square("seam", "stricter", 1.5, 1.5, 0.5, 2.0)]
    found = [region_at(regions, at, MM, FRAME, None) for at in ((12, 12), (17, 17), (50, 30))]
    assert [one and one.name for one in found] == ["face", "seam", None]
    moved = Pose(x_px=20.0)
    assert region_at(regions, (37, 17), MM, FRAME, moved) == regions[1]
    assert region_at(regions, (17, 17), MM, FRAME, moved) is None


def test_corners_lie_where_the_part_does() -> None:
    """A quarter turn about the middle of the picture brings the right side to the bottom."""
    corners = square("logo", "ignore", 4, 1, 1).corners_in_press(MM, (40, 40), Pose(turn_rad=math.pi / 2))
    np.testing.assert_allclose(corners, [(30, 40), (30, 50), (20, 50), (20, 40)], atol=1e-9)


def test_what_is_ignored_is_said_in_mm2() -> None:
    drawn = DrawnRegions((square("logo", "ignore", 1, 1, 1),), 12.34, 180.2)
    assert drawn.describe() == "ignored: 12.3 mm2 of 180 mm2 contact; 1 ignore"
    assert DrawnRegions((square("s", "stricter", 1, 1, 1, 2.0),)).describe() == "1 stricter (limit / 2)"


TRIANGLE = ((0, 0), (1, 0), (1, 1))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"points_mm": TRIANGLE[:2]}, "region 'logo' has 2 points, expected 3 to 256"),
        ({"points_mm": ((0, 0), (1, 0), (1, math.nan))}, "not two finite numbers of mm"),
        ({"points_mm": ((0, 0), (1, 0), (math.inf, 1))}, "not two finite numbers of mm"),
        ({"points_mm": ((0, 0), (1, 1), (1, 0), (0, 1))}, "crosses itself"),
        ({"points_mm": ((0, 0), (2, 0), (1, 0), (1, 1))}, "crosses itself"),
        ({"points_mm": ((0, 0), (1, 0), (2, 0))}, "has no area"),
        ({"points_mm": ((0, 0), (1, 0), (1, 0), (1, 1))}, "crosses itself"),
        ({"points_mm": tuple((math.cos(k), math.sin(k)) for k in range(300))}, "300 points"),
        ({"kind": "blind"}, "of the kind 'blind', expected ignore, judge or stricter"),
        ({"kind": "stricter"}, "the factor 1, expected more than 1 and at most 10"),
        ({"kind": "stricter", "factor": 10.5}, "the factor 10.5, expected more than 1"),
        ({"kind": "stricter", "factor": math.nan}, "the factor nan, expected more than 1"),
        ({"factor": 2.0}, "the factor 2, and ignore has none"),
        ({"name": ""}, "a name of 1 to 64 characters"),
        ({"name": "a\nb"}, "a name of 1 to 64 characters"),
    ],
)
def test_a_wrong_region_gets_a_sentence(wrong: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        DrawnRegion(**{"name": "logo", "kind": "ignore", "points_mm": TRIANGLE, **wrong})  # type: ignore[arg-type]


def test_two_regions_of_one_name_and_one_outside_the_field_get_a_sentence() -> None:
    one = square("logo", "ignore", 5, 1, 2)
    with pytest.raises(ValueError, match="two regions have the name 'logo'"):
        DrawnRegions((one, one))
    with pytest.raises(ValueError, match=r"a point at \(7, 1\) mm, outside the field of 6.0 x 4.0 mm"):
        one.check_inside(FRAME, MM)
    square("logo", "ignore", 4, 1, 2).check_inside(FRAME, MM)


@some.composite
def star(draw: some.DrawFn) -> tuple[tuple[float, float], ...]:
    """A polygon around a middle, which crosses itself nowhere."""
    x, y = draw(some.floats(1, 5)), draw(some.floats(1, 3))
    radii = draw(some.lists(some.floats(0.2, 1.0), min_size=3, max_size=8))
    turns = [2 * math.pi * k / len(radii) for k in range(len(radii))]
    return tuple((x + r * math.cos(t), y + r * math.sin(t)) for r, t in zip(radii, turns, strict=True))


@given(star(), star(), some.floats(1.01, 10), some.integers(0, 2**32 - 1))
def test_ignoring_raises_no_score_and_stricter_lowers_none(
    logo: tuple[tuple[float, float], ...], seam: tuple[tuple[float, float], ...], factor: float, seed: int
) -> None:
    """Of any score map: what is ignored takes nothing from the scores of other places, and no fail becomes a pass by a
    factor."""
    scores = np.random.default_rng(seed).exponential(0.5, FRAME).astype(np.float32)
    ignoring = weigh_places([DrawnRegion("logo", "ignore", logo)], FRAME, MM)
    stricter = weigh_places([DrawnRegion("seam", "stricter", seam, factor)], FRAME, MM)

    assert {*np.unique(ignoring)} <= {0.0, 1.0}
    assert (scores * ignoring).max() <= scores.max()
    assert (scores * ignoring).max() == scores[ignoring > 0].max()
    assert (scores * stricter >= scores).all()


@given(star())
def test_the_drawn_area_is_the_polygon(points: tuple[tuple[float, float], ...]) -> None:
    """The pixels are those of the polygon, to half of a pixel's diagonal at its border and a pixel at a corner."""
    region = DrawnRegion("logo", "ignore", points)
    closed = (*points, points[0])
    area = abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in itertools.pairwise(closed))) / 2
    around = sum(math.dist(a, b) for a, b in itertools.pairwise(closed))
    assert abs(region.mask(FRAME, MM).sum() * 0.01 - area) <= 0.0708 * around + 0.01 * len(points)
