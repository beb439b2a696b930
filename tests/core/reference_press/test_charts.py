"""What the newest reference press says: limits learnt, in and out of limits, new gel, new bundle, wrong verdict."""

import datetime
import re
from collections.abc import Sequence
from dataclasses import replace

import pytest

from edge.core.reference_press.charts import ReferencePress, charts, judge, why_due
from edge.core.reference_press.outcome import Imprint, Outcome

LEARN = 5
WOBBLE = (0.0, 1.0, -1.0, 0.5, -0.5)


def press(n: int, **changes: object) -> ReferencePress:
    """The n-th press: small differences that repeat after five."""
    off = WOBBLE[n % 5]
    imprint = Imprint(2.0 + 0.02 * off, 9.0 + 0.1 * off, 7.0 + 0.1 * off, 80.0 + 0.2 * off, 1.0 + 0.05 * off)
    made = ReferencePress(f"P{n}", n, "g1", "b1", "pass", "pass", 0.4 + 0.01 * off, 1.0, imprint)
    return replace(made, **changes)  # type: ignore[arg-type]


def learnt(count: int = LEARN) -> list[ReferencePress]:
    return [press(n) for n in range(count)]


WRONG = press(2, verdict="fail", score=1.5)
MOVED, WEAK = (Imprint(strength, x, 7.0, None, 1.0) for strength, x in ((2.0, 12.0), (1.0, 9.0)))


def outcome(presses: Sequence[ReferencePress]) -> Outcome:
    return judge(presses, LEARN).outcome


def test_limits_are_learnt_from_the_first_presses() -> None:
    """Each says how many there are; from the next one on there are limits."""
    said = [judge(learnt(n), LEARN) for n in range(1, LEARN + 1)]

    assert [one.outcome for one in said[:-1]] == [Outcome.LEARNING] * 4
    assert said[1].sentences == ("limits are learnt: 2 of 5 presses",)
    assert outcome(learnt(6)) is Outcome.IN_LIMITS
    assert {chart.measure.name for chart in charts(learnt(6), LEARN)} == {
        *("score", "strength_levels", "x_mm", "y_mm", "turn_deg", "noise_levels")
    }


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"score": 0.9}, r"score is 0.9, the limits are .*; clean gel and master piece"),
        ({"imprint": Imprint(4.0, 9.0, 7.0, None, 1.0)}, r"strength is 4 levels, .*; check the force"),
        ({"imprint": MOVED}, r"place x is 12 mm, .*; check fixture"),
        ({"imprint": Imprint(2.0, 9.0, 9.0, 80.0, 1.0)}, r"place y is 9 mm, .*; check fixture"),
        ({"imprint": Imprint(2.0, 9.0, 7.0, 83.0, 1.0)}, r"turn is 83 deg, .*; check fixture"),
        ({"imprint": Imprint(2.0, 9.0, 7.0, None, 3.0)}, r"noise is 3 levels, .*; check light"),
        ({"verdict": "fail", "score": 0.4}, r"its verdict is fail, this master piece must give pass"),
    ],
)
def test_each_measure_out_of_limits_says_what_to_do(changes: dict[str, object], word: str) -> None:
    """The value, the limits, and where to look."""
    found = judge([*learnt(6), press(6, **changes)], LEARN)

    assert found.outcome is Outcome.OUT_OF_LIMITS
    assert any(re.search(word, sentence) for sentence in found.sentences)


FAILING = [press(n, expected="fail", verdict="fail", score=1.4 + 0.01 * WOBBLE[n % 5]) for n in range(6)]
OTHER = press(6, bundle_id="b2", score=40.0, threshold=100.0)
OUTCOMES = {
    "an odd one among the first makes wide limits": ([*learnt(4), press(4, score=0.9)], Outcome.IN_LIMITS),
    "another verdict is out before there are limits": ([*learnt(2), WRONG], Outcome.OUT_OF_LIMITS),
    "a damaged master piece fails": (FAILING, Outcome.IN_LIMITS),
    "a damaged master piece that passes": ([*FAILING, press(6, expected="fail")], Outcome.OUT_OF_LIMITS),
    "a new bundle has another scale of scores": ([*learnt(6), OTHER], Outcome.LEARNING),
    "with a new bundle strength is compared": (
        [*learnt(6), replace(OTHER, imprint=WEAK)],
        Outcome.OUT_OF_LIMITS,
    ),
    "on a new gel the place is compared": (
        [*learnt(6), press(6, gel_id="g2", imprint=MOVED)],
        Outcome.OUT_OF_LIMITS,
    ),
}


@pytest.mark.parametrize("name", OUTCOMES)
def test_outcomes(name: str) -> None:
    presses, expected = OUTCOMES[name]
    assert outcome(presses) is expected


def test_eight_on_one_side_are_a_warning() -> None:
    """The scores have shifted by one standard deviation: no single one is out."""
    shifted = [press(n, score=0.41 + 0.001 * (n % 2)) for n in range(6, 14)]
    found = judge([*learnt(6), *shifted], LEARN)

    assert found.outcome is Outcome.WARNING
    assert found.sentences == (
        "score: the last eight are on one side of the centre: it has shifted; clean gel and master piece, look at its "
        "picture",
    )
    assert outcome([*learnt(6), *shifted[:-1]]) is Outcome.IN_LIMITS


def test_a_press_without_a_score_says_nothing_of_the_station() -> None:
    """It is not learnt, no more than one with another verdict than expected, and says why."""
    slid = press(2, verdict="rejected", score=None, reason="not_settled: it slid")
    found = judge([*learnt(2), slid], LEARN)

    assert found.outcome is Outcome.NOT_MEASURED
    assert found.sentences == ("not_settled: it slid; press the piece again",)
    for other in (slid, WRONG):
        found = judge([*learnt(2), other, press(3)], LEARN)
        assert found.sentences == ("limits are learnt: 3 of 5 presses",)


def test_a_new_gel_begins_new_charts_and_keeps_the_place() -> None:
    """Strength may change with the gel."""
    harder = press(6, gel_id="g2", imprint=Imprint(3.0, 9.0, 7.0, None, 1.2))
    found = judge([*learnt(6), harder], LEARN)

    assert found.outcome is Outcome.LEARNING
    assert found.sentences == (
        "limits are learnt: 1 of 5 presses",
        "the first one on gel g2: its charts begin again, the limits of the place remain",
    )


def test_charts_begin_again_on_request() -> None:
    """After the fixture was moved on purpose."""
    moved = press(6, imprint=MOVED, is_start=True)

    assert judge([*learnt(6), moved], LEARN).sentences == ("limits are learnt: 1 of 5 presses",)


def test_a_part_that_lies_the_other_way_round_has_no_jump_in_its_turn() -> None:
    """-179.9 degrees are next to 179.9; a quarter of a turn is out of limits."""
    turns = (179.9, -179.9, 180.0, 179.8, -179.8, -179.9)
    presses = [press(n, imprint=Imprint(2.0, 9.0, 7.0, turn, 1.0)) for n, turn in enumerate(turns)]
    turned = press(6, imprint=Imprint(2.0, 9.0, 7.0, -90.0, 1.0))

    assert outcome(presses) is Outcome.IN_LIMITS
    assert any("turn is 270 deg" in one for one in judge([*presses, turned], LEARN).sentences)


NOON = datetime.datetime(2026, 3, 2, 12, tzinfo=datetime.UTC)
SHIFTS = (datetime.time(6), datetime.time(14), datetime.time(22))


def at(hours: float) -> int:
    return round((NOON + datetime.timedelta(hours=hours)).timestamp() * 1e9)


@pytest.mark.parametrize(
    ("last_h", "now_h", "shifts", "expected"),
    [
        (None, 0, (), "there was none with this gel and bundle"),
        (-7.9, 0, (), None),
        (-8, 0, (), "the last one is more than 8 h old"),
        (1, 0, (), "the last one is in the future, so the clock was set back"),
        (-1, 0, SHIFTS, None),
        (-7, 0, SHIFTS, "the shift of 06:00 has begun since the last one"),
        (0, 2, SHIFTS, "the shift of 14:00 has begun since the last one"),
        (9, 12, SHIFTS, "the shift of 22:00 has begun since the last one"),
        (10.5, 17.9, SHIFTS, None),
    ],
)
def test_it_is_due_after_hours_and_at_each_shift(
    last_h: float | None, now_h: float, shifts: tuple[datetime.time, ...], expected: str | None
) -> None:
    """Hours from noon; the night shift began on the day before."""
    last = None if last_h is None else at(last_h)

    assert why_due(last, at(now_h), 8, shifts, datetime.UTC) == expected
