"""A gel over many presses: what is named gel, what is masked, and what never is."""

from dataclasses import replace

import numpy as np
import pytest

from edge.core.contact.table import State
from edge.core.gel_scars import gel_scars
from edge.core.gel_scars.free_change import FreeViews, marks
from edge.core.gel_scars.gel_scars import GelScars, Judged
from edge.core.gel_scars.press import ScoredPress, measure_moves
from edge.core.imaging.region import Region
from edge.core.registration.pose import Pose, PoseUncertainty, Registered
from edge.core.verdict import Cause

SIZE = (320, 240)
REGION = Region.centre(SIZE)
SCALE = (0.0634, 0.0634)
FREE = np.full((120, 160, 3), 120, np.float32)
# Rows and columns of the 160x120 view.
IN_VIEW = (slice(54, 62), slice(76, 84))


def scored(picture: np.ndarray, moved_mm: tuple[float, float] | None = None) -> ScoredPress:
    """A press of this view, float32 (120, 160, 3), as a detector of flat parts scores it: 0.2, and a quarter for each
    level of difference to the free gel, against a limit of 1; the part touches everything."""

    def score_map(change: np.ndarray | float) -> np.ndarray:
        height = 0.2 + np.abs(picture - FREE - change).max(axis=2) / 4
        return REGION.crop(np.repeat(np.repeat(height, 2, axis=0), 2, axis=1).astype(np.float32))

    return ScoredPress(
        score_map(0), 1.0, REGION, SIZE, SCALE, np.ones((120, 160), bool), None, moved_mm, score_map
    )


def press(
    height: float = 0.0, moved_mm: tuple[float, float] | None = None, free: np.ndarray = FREE
) -> ScoredPress:
    """Of a part that rises at the place by so much of the map, on this gel."""
    picture = free.copy()
    picture[IN_VIEW] += np.float32(4 * height)
    return scored(picture, moved_mm)


def marked(levels: float) -> np.ndarray:
    """The free gel with a mark at the place."""
    free = FREE.copy()
    free[IN_VIEW] += np.float32(levels)
    return free


def causes(gel: GelScars, presses: int, free: np.ndarray | None = FREE) -> list[Cause | None]:
    """Of presses of pieces damaged at the place, little above the limit."""
    found = [gel.judge(press(1), free) for _ in range(presses)]
    return [one.blame.cause if one.blame else None for one in found]


def test_a_mark_is_named_once_and_then_masked_with_its_area() -> None:
    """16x16 pixels of 0.0634 mm and 0.25 mm around are 2.3 mm2; the press after it has nothing above the limit."""
    gel = GelScars(first=FREE)
    named, after = (gel.judge(press(free=marked(20)), marked(20)) for _ in range(2))

    assert named.blame is not None
    assert named.blame.cause is Cause.GEL
    assert (named.is_new, named.blind_mm2, named.masked.any()) == (True, 0, False)
    assert after.blame is None
    assert after.blind_mm2 == pytest.approx(((16 + 8) * 0.0634) ** 2, rel=0.1)
    assert after.blind_share == pytest.approx(after.blind_mm2 / (224 * 0.0634) ** 2, rel=0.01)


BLAMED = {
    "damage that is there without the mark": (press(8, free=marked(20)), Cause.PART),
    **{f"a mark that contact flattens to {n}": (press(free=marked(n)), Cause.GEL) for n in (9, 14, 20)},
    "damage that the mark has doubled": (press(2.4, free=marked(20)), Cause.UNSURE),
    "no second score": (replace(press(free=marked(20)), without=lambda change: None), Cause.PART),
}


@pytest.mark.parametrize("name", BLAMED)
def test_a_press_at_a_mark_of_twenty_levels(name: str) -> None:
    """Where the free gel shows a mark, a part may be damaged as well; neither alone may give what the press shows."""
    seen, cause = BLAMED[name]
    blame = GelScars(first=FREE).judge(seen, marked(20)).blame
    assert blame is not None
    assert blame.cause is cause


def test_damage_at_a_masked_scar_is_damage_as_far_as_it_is_seen() -> None:
    """A shallow dent over a known scar that shows far more: what lies around the mask is judged."""
    gel, dent = GelScars(first=FREE), marked(60)
    gel.judge(press(free=marked(60)), marked(60))
    dent[48:68, 72:88] += 6
    blame = gel.judge(scored(dent), marked(60)).blame

    assert blame is not None
    assert blame.cause is Cause.PART


def test_a_press_is_scored_again_only_where_a_mark_is_near() -> None:
    """A quiet press, damage on a clean gel, and damage far from a mark cost no second score."""
    asked = list[np.ndarray]()

    def without(change: np.ndarray) -> None:
        asked.append(change)

    far = FREE.copy()
    far[20:28, 40:48] += 20
    for one, free in ((press(), marked(20)), (press(5), FREE), (press(5), far)):
        GelScars(first=FREE).judge(replace(one, without=without), free)
    assert not asked

    GelScars(first=FREE).judge(replace(press(5), without=without), marked(20))
    assert len(asked) == 1
    assert asked[0][IN_VIEW].min() > 15
    assert not asked[0][:40].any()


def test_pieces_damaged_at_one_place_in_a_fixture_are_never_a_scar() -> None:
    """The free gel shows nothing: part; after five in a row a broken tool and a hidden scar look the same: unsure."""
    gel = GelScars(first=FREE)
    found = causes(gel, 40)

    assert found[:2] == [Cause.PART, Cause.PART]
    assert found[5:] == [Cause.UNSURE] * 35
    assert not gel.record.masked.any()


def test_good_presses_are_no_repeats() -> None:
    """Damage after many good pieces is the piece's, as on a new gel."""
    gel = GelScars(first=FREE)
    for _ in range(12):
        gel.judge(press(), FREE)

    assert causes(gel, 1) == [Cause.PART]


def test_without_the_free_gel_repeated_damage_is_unsure_and_never_masked() -> None:
    """A line that lifts too briefly, or a station without a first picture."""
    for gel, free in ((GelScars(first=FREE), None), (GelScars(), FREE)):
        assert causes(gel, 12, free) == [Cause.UNSURE] * 12
        assert not gel.record.masked.any()


def test_a_place_that_stays_while_the_part_moves_is_a_scar() -> None:
    """Three presses do not decide; the fourth does, and the fifth is judged without the place."""
    gel, found = GelScars(first=FREE), list[Judged]()
    for k in range(5):
        found.append(gel.judge(press(5, (3.0 * k, 0.0)), FREE))

    assert [one.blame and one.blame.cause for one in found] == [Cause.PART] * 3 + [Cause.GEL, None]


def test_what_is_masked_lies_near_the_mark() -> None:
    """A place far wider than its mark, which has a faint rim of its own: what is beyond 2.5 mm of it is judged on."""
    gel, wide, free = GelScars(first=FREE), FREE.copy(), FREE.copy()
    free[57:59, 70:100] += 30
    wide[57:59, 34:134] += 4
    wide[57:59, 70:100] += 30

    assert gel.judge(scored(wide), free).is_new
    columns = np.flatnonzero(gel.record.masked.any(axis=0))
    assert columns.min() >= 70 - 20
    assert columns.max() <= 99 + 20
    assert gel.judge(scored(wide), free).blame is not None


def test_known_scars_are_judged_where_nothing_is_masked() -> None:
    """And named each time."""
    gel = GelScars(first=FREE)
    for _ in range(3):
        judged = gel.judge(press(free=marked(20)), marked(20), is_masking=False)
        assert judged.blame is not None
        assert (judged.blame.cause, judged.blind_mm2) == (Cause.GEL, 0)


def beside(*places: tuple[slice, slice]) -> ScoredPress:
    """A press whose map is 5 at these places of the view; the part reaches the place of `press` and 2 mm around."""
    picture = FREE.copy()
    for place in places:
        picture[place] += np.float32(20)
    reach = np.zeros((120, 160), bool)
    reach[38:78, 60:100] = True
    return replace(scored(picture), reach=reach)


def speck(row: int, column: int = 110) -> tuple[slice, slice]:
    return slice(row, row + 4), slice(column, column + 4)


def test_what_lies_beyond_the_part_is_not_judged_and_hides_nothing_of_the_contact() -> None:
    """The speck raises nothing by itself; with damage in the part, the damage alone is blamed."""
    gel = GelScars(first=FREE)
    alone, both = gel.judge(beside(speck(20)), None), gel.judge(beside(speck(20), IN_VIEW), None)

    assert (alone.blame, alone.blind_mm2) == (None, 0)
    assert both.blame is not None
    assert not gel.record.masked.any()


def test_a_place_that_reaches_the_part_is_judged_to_its_end() -> None:
    """Damage at the edge of the part whose excess runs 2 mm beyond it."""
    judged = GelScars(first=FREE).judge(beside((slice(50, 54), slice(96, 116))), FREE)

    assert judged.blame is not None
    assert not judged.masked.any()


def test_a_place_that_exceeds_in_five_presses_in_a_row_is_repeated() -> None:
    """Within 1 mm, whatever else exceeds; a press without it ends that. The place: of the speck's first 4 pixels, its
    middle."""
    gel = GelScars(first=FREE)
    found = [gel.judge(beside(speck(20 + n % 2), speck(90, 30 + 20 * (n % 3))), None) for n in range(6)]
    found.append(gel.judge(beside(), None))
    places = [one.repeated for one in found]

    assert [one is not None for one in places] == [False] * 4 + [True, True, False]
    assert places[4] is not None
    assert places[4].is_outside
    assert (places[4].x_mm, places[4].y_mm) == pytest.approx((176 * 0.0634, 37 * 0.0634), abs=0.13)


def test_the_place_that_is_repeated_is_named_and_not_a_larger_one_of_this_press() -> None:
    gel, large = GelScars(first=FREE), (slice(84, 104), slice(40, 60))
    found = [gel.judge(beside(speck(20), *[large] * (n == 4)), None).repeated for n in range(5)]
    assert found[4] is not None
    assert found[4].y_mm == pytest.approx(37 * 0.0634, abs=0.13)


def test_presses_between_which_others_pass_are_no_repeats_at_the_edge_of_the_region_either() -> None:
    """What lies beyond the region is never shown: counts there would stay for ever."""
    picture = FREE.copy()
    picture[4:12, 76:84] += np.float32(12)  # the region begins in row 4
    gel = GelScars()

    presses = [*[scored(picture)] * 4, press()] * 3
    assert [gel.judge(each, None).repeated for each in presses] == [None] * 15


def test_damage_that_moves_with_the_part_is_not_repeated_and_of_a_fixture_it_is_said_to_be_reached() -> None:
    """Five bad parts: the gel or the parts, which cannot be told, so the place is not called the gel's."""
    moving, held = GelScars(first=FREE), GelScars(first=FREE)
    moved = [moving.judge(beside(speck(40 + 18 * (n % 2), 62 + 9 * (n % 3))), None) for n in range(8)]
    fixed = [held.judge(beside(IN_VIEW), None) for _ in range(5)]

    assert [one.repeated for one in moved] == [None] * 8
    assert fixed[4].repeated is not None
    assert not fixed[4].repeated.is_outside
    assert all(one.blame is not None for one in fixed)


def test_parts_that_fail_by_turns_on_both_sides_of_a_place_are_not_said_to_fail_by_nothing() -> None:
    """As where a drawn region is stricter: the place between is reached by the part, and each press fails."""
    gel = GelScars(first=FREE)
    found = [gel.judge(beside(speck(50, 62 + 14 * (n % 2))), None) for n in range(5)]

    assert found[4].repeated is not None
    assert not found[4].repeated.is_outside


def test_a_known_scar_is_not_said_to_be_repeated() -> None:
    """It is masked, and how much is masked has an alarm of its own."""
    gel = GelScars(first=FREE)

    assert [gel.judge(press(free=marked(20)), marked(20)).repeated for _ in range(8)] == [None] * 8


@pytest.mark.parametrize("size", [(48, 40), (160, 120), (320, 240), (1280, 720)])
def test_a_place_is_the_same_in_pictures_of_any_size(size: tuple[int, int]) -> None:
    """What exceeds in the map exceeds in the view, and nothing far from it does."""
    region = Region.full(size)
    score_map = np.zeros((size[1], size[0]), np.float32)
    rows, columns = slice(size[1] // 2, size[1] // 2 + 2), slice(size[0] // 4, size[0] // 4 + 2)
    score_map[rows, columns] = 3
    scored = ScoredPress(score_map, 1.0, region, size, SCALE)
    excess = scored.excess()
    back = scored.in_map(excess > 0)

    assert excess.max() == pytest.approx(2)
    assert back[rows, columns].all()
    assert back.mean() < 0.01


def test_marks_are_found_once_for_the_same_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stage asks ahead; a mean of later views, another first picture or another imprint is another question."""
    asked = list[tuple[object, ...]]()
    monkeypatch.setattr(gel_scars, "marks", lambda *given, **how: asked.append(given) or marks(*given, **how))
    gel, views, left = GelScars(first=FREE), FreeViews(), np.zeros_like(FREE)
    for second in range(6):
        views.see(State.NO_CONTACT, marked(20), second * 10**9)
    before = views.mean()
    gel.find_marks(before, left)
    assert gel.judge(press(free=marked(20)), before, left).blame is not None
    assert len(asked) == 1
    for second in range(6, 12):
        views.see(State.NO_CONTACT, FREE, second * 10**9)
    after = views.mean()
    assert before is not None
    assert after is not None
    assert before[IN_VIEW].mean() == 140  # what was asked about stays as it was
    found = gel.find_marks(after, left)
    assert found is not gel.find_marks(before, left)
    gel.first = marked(0)
    gel.find_marks(before, left)
    gel.find_marks(before, None)
    assert len(asked) == 5


def test_marks_of_a_moment_after_the_release_are_found_ahead_with_and_without_the_rest_of_the_press(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A press that fails is recorded without a further look for marks."""
    asked = list[dict[str, bool]]()
    monkeypatch.setattr(gel_scars, "marks", lambda *given, **how: asked.append(how) or marks(*given, **how))
    gel, free, left = GelScars(first=FREE), marked(20), np.zeros_like(FREE)
    gel.is_fresh = True
    gel.find_marks(free, left)
    assert asked == [{"is_fresh": True}, {}]
    assert gel.judge(press(free=free), free, left).blame is not None
    assert len(asked) == 2


def pose_about(place: np.ndarray, turn_rad: float) -> Pose:
    """A part that is turned about this place of the region, (x, y) pixels."""
    at = Pose(turn_rad=turn_rad).matrix((REGION.width, REGION.height)) @ [*place, 1]
    return Pose(*(place - at), turn_rad)


def placed(pose: Pose, is_unique: bool = True) -> Registered:
    rgb, seen = np.zeros((1, 1, 3), np.uint8), np.ones((1, 1), bool)
    return Registered(rgb, seen, pose, PoseUncertainty(0, 0, 0), 1.0, 1.0, is_unique=is_unique)


def test_how_far_a_place_of_the_part_has_moved() -> None:
    """By the shift where nothing turns; not at all where it turns about; by the chord elsewhere."""
    there, pin = (58, 80), np.array([160.5, 116.5]) - (REGION.x, REGION.y)
    shift = measure_moves(placed(Pose(8, -3)), REGION, SIZE, SCALE)
    np.testing.assert_allclose(shift[:, 5, 7], np.array([8, -3]) * SCALE, atol=1e-5)
    turned = measure_moves(placed(pose_about(pin, 0.3)), REGION, SIZE, SCALE)
    np.testing.assert_allclose(turned[:, *there], 0, atol=1e-4)
    chord = 2 * 20 * SIZE[0] / 160 * np.sin(0.15) * SCALE[0]
    assert np.hypot(*turned[:, 58, 100]) == pytest.approx(chord, rel=1e-3)


@pytest.mark.parametrize(("is_pin", "is_unique"), [(True, True), (False, True), (False, False)])
def test_damage_about_which_the_part_turns_is_no_scar(is_pin: bool, is_unique: bool) -> None:
    """A pin holds each part there, and each has the same damage: it is of one place of the part, as it is of the gel.
    What comes back to the gel under other places of the part is a scar, if the part has one pose alone: a regular part
    that seems to lie a pitch further on lies where it lay."""
    gel, pin = GelScars(first=FREE), np.array([160.5, 116.5]) - (REGION.x, REGION.y)
    found = []
    for turn_rad in np.random.default_rng(0).uniform(-0.5, 0.5, 12):
        pose = pose_about(pin if is_pin else pin + 60, turn_rad)
        one = replace(press(1), moved_mm=measure_moves(placed(pose, is_unique), REGION, SIZE, SCALE))
        judged = gel.judge(one, FREE)
        found.append(judged.masked.any() or (judged.blame is not None and judged.blame.cause is Cause.GEL))
    assert any(found) == (is_unique and not is_pin)


def test_what_was_not_judged_is_outside_the_extent() -> None:
    """The lower half of the region: rows 120 to 231 of the picture are rows 60 to 115 of the view."""
    unseen = np.zeros((224, 224), bool)
    unseen[112:] = True
    whole, judged = press().extent(), replace(press(), unseen=unseen).extent()
    assert (judged[:60] == whole[:60]).all()
    assert whole[60:116].any()
    assert not judged[60:].any()
