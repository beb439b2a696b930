"""A gel over many presses: what is named gel, what is masked, and what never is."""

import numpy as np
import pytest

from edge.core.gel_scars.causes import Cause
from edge.core.gel_scars.gel_scars import GelScars, Judged
from edge.core.gel_scars.press import ScoredPress
from edge.core.imaging.region import Region

SIZE = (320, 240)
REGION = Region.centre(SIZE)
SCALE = (0.0634, 0.0634)
FREE = np.full((120, 160, 3), 120, np.float32)
# The same place: rows and columns of the 224x224 map, and of the 160x120 view.
IN_MAP = (slice(100, 116), slice(104, 120))
IN_VIEW = (slice(54, 62), slice(76, 84))


def press(height: float = 0.0, place_mm: tuple[float, float] | None = None) -> ScoredPress:
    """A map of 0.2 that rises to `height` at the place, against a limit of 1; the part touches everything."""
    score_map = np.full((224, 224), 0.2, np.float32)
    score_map[IN_MAP] += np.float32(height)
    return ScoredPress(score_map, 1.0, REGION, SIZE, SCALE, np.ones((120, 160), bool), None, place_mm)


def marked(levels: float) -> np.ndarray:
    """The free gel with a mark at the place."""
    free = FREE.copy()
    free[IN_VIEW] += np.float32(levels)
    return free


def causes(gel: GelScars, presses: int, free: np.ndarray | None = FREE) -> list[Cause | None]:
    found = [gel.judge(press(5), free) for _ in range(presses)]
    return [one.blame.cause if one.blame else None for one in found]


def test_a_mark_is_named_once_and_then_masked_with_its_area() -> None:
    """16x16 pixels of 0.0634 mm and 0.25 mm around are 2.3 mm2; the press after it has nothing above the limit."""
    gel = GelScars(first=FREE)
    named, after = (gel.judge(press(5), marked(20)) for _ in range(2))

    assert named.blame is not None
    assert named.blame.cause is Cause.GEL
    assert (named.is_new, named.blind_mm2, named.masked.any()) == (True, 0, False)
    assert after.blame is None
    assert after.highest == pytest.approx(0.2)
    assert after.blind_mm2 == pytest.approx(((16 + 8) * 0.0634) ** 2, rel=0.1)
    assert after.blind_share == pytest.approx(after.blind_mm2 / (224 * 0.0634) ** 2, rel=0.01)


def test_pieces_damaged_at_one_place_in_a_fixture_are_never_a_scar() -> None:
    """The free gel shows nothing: part; after five in a row a broken tool and a hidden scar look the same: unsure."""
    gel = GelScars(first=FREE)
    found = causes(gel, 40)

    assert found[:2] == [Cause.PART, Cause.PART]
    assert found[5:] == [Cause.UNSURE] * 35
    assert not gel.record.masked.any()


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


def test_a_mark_with_which_presses_were_quiet_does_not_explain_a_clear_fail() -> None:
    """It has been there before; one that grew by more than a third since does, and a slight fail is the mark's: low,
    and not wide."""
    rises = ((20, 5, Cause.PART), (35, 5, Cause.GEL), (20, 0.95, Cause.GEL), (20, 1.5, Cause.PART))
    for levels, height, cause in rises:
        gel = GelScars(first=FREE)
        for _ in range(3):
            assert gel.judge(press(), marked(20)).blame is None
        blame = gel.judge(press(height), marked(levels)).blame

        assert blame is not None
        assert blame.cause is cause


def test_a_quiet_press_of_a_part_that_lay_elsewhere_says_nothing_of_a_mark() -> None:
    """Registration knows the place: the mark lay under flat metal before, and under a tooth now."""
    gel = GelScars(first=FREE)
    for k in range(3):
        assert gel.judge(press(0, (3.0 * k, 0.0)), marked(20)).blame is None
    blame = gel.judge(press(5, (1.0, 4.0)), marked(20)).blame

    assert blame is not None
    assert blame.cause is Cause.GEL


def test_a_mark_with_which_presses_were_quiet_explains_what_mostly_exceeds_there_of_late() -> None:
    """Three quiet presses, three that exceed in a fixture: from the fourth on the mark explains it."""
    gel = GelScars(first=FREE)
    for _ in range(3):
        gel.judge(press(), marked(20))
    found = [gel.judge(press(5), marked(20)).blame for _ in range(4)]

    assert [one and one.cause for one in found] == [Cause.PART] * 3 + [Cause.GEL]


def test_a_mark_of_which_one_end_exceeds_is_not_quiet_at_the_other() -> None:
    """A hair under a part that moves: the press after it exceeds at the other end."""
    gel, free, ends = GelScars(first=FREE), FREE.copy(), press()
    free[57:59, 40:120] += 20
    for columns in (slice(40, 56), slice(170, 186)):
        score_map = np.full((224, 224), 0.2, np.float32)
        score_map[100:108, columns] = 5
        ends = ScoredPress(score_map, 1.0, REGION, SIZE, SCALE, np.ones((120, 160), bool))
        blame = gel.judge(ends, free).blame

        assert blame is not None
        assert blame.cause is Cause.GEL


def test_what_is_masked_lies_near_the_mark() -> None:
    """A place far wider than its mark, which has a faint rim of its own: what is beyond 2.5 mm of it is judged on."""
    gel, wide = GelScars(first=FREE), press()
    score_map = wide.score_map.copy()
    score_map[96:120, 20:220] = 1.3
    score_map[IN_MAP] = 30
    wide = ScoredPress(score_map, 1.0, REGION, SIZE, SCALE, np.ones((120, 160), bool))
    free = FREE.copy()
    free[IN_VIEW[0], 70:100] += 20

    assert gel.judge(wide, free).is_new
    columns = np.flatnonzero(gel.record.masked.any(axis=0))
    assert columns.min() >= 70 - 20
    assert columns.max() <= 99 + 20
    blame = gel.judge(wide, free).blame
    assert blame is not None


def test_known_scars_are_judged_where_nothing_is_masked() -> None:
    """And named each time."""
    gel = GelScars(first=FREE)
    for _ in range(3):
        judged = gel.judge(press(5), marked(20), is_masking=False)
        assert judged.blame is not None
        assert (judged.blame.cause, judged.blind_mm2) == (Cause.GEL, 0)


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
