"""The plan of a month: what comes when, and that it is the same each time."""

from collections import Counter

import numpy as np
import pytest

from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import DAYS, SETS, Month
from calibration.fitting.damage.damage import KINDS
from edge.core.imaging.decode import decode
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import profile

MONTH = Month("development", 3, 900)
PRESSES = [press for day in range(DAYS) for press in MONTH.day(day)]


def test_the_rates_are_those_that_the_page_states() -> None:
    """1 % of 900 presses are damaged, 1 in 500 is of another part, and a speck comes every 60 presses."""
    truths = Counter(press.truth for press in PRESSES)

    assert (truths["damaged"], truths["wrong"]) == (9, 2)
    assert 5 <= sum(press.speck is not None for press in PRESSES) <= 30
    assert [press.number for press in PRESSES] == list(range(900))


def test_no_kind_of_damage_is_one_that_the_fit_renders() -> None:
    """A bundle's limit is chosen by dents, bumps and scratches."""
    kinds = {press.kind for press in PRESSES if press.kind}

    assert len(kinds) >= 6
    assert not kinds & set(KINDS)


def test_a_gel_has_its_rated_life_by_the_middle_where_another_is_mounted() -> None:
    """And the lamps lose a fifth of their light from the first press to the last."""
    assert [day for day in range(DAYS) if MONTH.is_gel_changed(day)] == [DAYS // 2]
    assert (MONTH.wear(0), MONTH.wear(450)) == (0, 1000)
    assert PRESSES[0].light == 1
    assert PRESSES[-1].light == pytest.approx(0.8, abs=1e-3)


@pytest.mark.parametrize(("presses", "questions"), [(10_000, 10), (1500, 10), (300, 2), (60, 1)])
def test_ten_questions_a_day_are_fewer_in_a_small_month(presses: int, questions: int) -> None:
    """One for each five presses of a day at most."""
    assert Month("development", 0, presses).questions == questions


def test_the_same_plan_comes_again_and_each_part_has_its_own() -> None:
    """Development and judgement have no part in common."""
    again = Month("development", 3, 900)

    assert again.day(4) == MONTH.day(4)
    assert Month("development", 4, 900).day(4) != MONTH.day(4)
    assert abs(SETS["development"] - SETS["judgement"]) > 1000


def test_dust_shows_on_the_free_gel_until_it_is_wiped() -> None:
    """The same moment with and without: a place brightens or darkens by more than noise does."""
    dusty = next(press for press in PRESSES if press.speck is not None and press.speck.size > 0.12)

    def look(*, is_dusty: bool) -> np.ndarray:
        gel = MountedGel(MONTH)
        gel.specks = [dusty.speck] if is_dusty and dusty.speck is not None else []
        sensor = profile("cropped_lr")
        return np.mean([decode(CameraFrame(one, 0, 0), sensor) for one in gel.free(dusty, 2.0)], axis=0)

    change = np.abs(look(is_dusty=True) - look(is_dusty=False)).max(axis=2)
    assert change.max() > 6
    assert np.median(change) < 1


@pytest.mark.parametrize("part", [0, 1])
def test_each_gel_of_a_month_varies_about_the_sensor_and_not_about_the_one_before(part: int) -> None:
    """The thirtieth gel shows a press about as strongly as the first, and not half or twice as strongly."""
    gels = [MountedGel(Month("development", part, 900), number) for number in (0, 28, 29, 30)]
    first, *others = (float((gel.nominal(0, 0) - gel.nominal_free(0).astype(float)).std()) for gel in gels)

    assert all(0.7 < strength / first < 1.4 for strength in others)
    assert len({round(strength, 3) for strength in others}) == 3
