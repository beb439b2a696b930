"""Press again: when a second press pays, what two presses say together, and that the promise holds."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.fitting.limits.threshold import conformal_threshold
from edge.core.imaging.quality import Reason, Rejection
from edge.core.press import AGREED
from edge.core.press_again import (
    Costs,
    KnownScores,
    Plan,
    SeenScores,
    is_asked,
    plan,
    score_both,
    second_verdict,
    unsure,
)
from edge.core.sentence import Sentence
from edge.core.verdict import Kind, Verdict, decide

COSTS = Costs(missed=1000, false_alarm=200, press=1, defect_rate=0.01)
AT_ONE, NARROW = partial(decide, threshold=1.0), partial(decide, threshold=1.0, tolerance=0.01)
ALPHA = 0.05
Scores = NDArray[np.float64]
SIZES = (1.0, 2.5, 4.0)


def sound_scores(rng: np.random.Generator, pieces: int, presses: int, correlation: float) -> Scores:
    """Normal scores, (pieces, presses): presses of one piece have this correlation."""
    piece = rng.standard_normal((pieces, 1))
    own = rng.standard_normal((pieces, presses))
    return math.sqrt(correlation) * piece + math.sqrt(1 - correlation) * own


def damaged_scores(rng: np.random.Generator, count: int) -> tuple[tuple[float, ...], ...]:
    """Of each size, shifted normal scores."""
    return tuple(tuple((rng.standard_normal(count) + size).tolist()) for size in SIZES)


def known(rng: np.random.Generator, pieces: int = 60, correlation: float = 0.3) -> KnownScores:
    sound = sound_scores(rng, pieces, 2, correlation)
    return KnownScores(tuple(map(tuple, sound.tolist())), damaged_scores(rng, 40))


def planned(rng: np.random.Generator, costs: Costs = COSTS, correlation: float = 0.3) -> tuple[float, Plan]:
    """(threshold, plan) of a bundle that was fitted on random pieces."""
    found = known(rng, correlation=correlation)
    threshold = limit(found.sound)
    return threshold, plan(found, threshold, ALPHA, costs)


def limit(sound: tuple[tuple[float, ...], ...]) -> float:
    """As `fit` finds it."""
    pieces = [str(k) for k, scores in enumerate(sound) for _ in scores]
    return conformal_threshold(np.concatenate(list(map(np.asarray, sound))), ALPHA, specimens=pieces).value


def two_presses(threshold: float, bound: float, first: Scores, second: Scores) -> tuple[Scores, Scores]:
    """(fails, presses) of each piece, as the station decides them: see `test_the_simulation_decides_as_the_station`."""
    asked = (first > threshold) & (first <= bound)
    fails = np.where(asked, np.minimum(first, second), first) > threshold
    return fails.astype(np.float64), 1.0 + asked


def test_the_simulation_decides_as_the_station() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.standard_normal((2, 50)) + 0.8
    fails, presses = two_presses(1.0, 1.5, first, second)
    for one, two, is_fail, count in zip(first.tolist(), second.tolist(), fails, presses, strict=True):
        verdict = decide(one, 1.0)
        is_second = is_asked(verdict, 1.5)
        if is_second:
            verdict = second_verdict(decide(two, 1.0), one, None, AT_ONE)
        assert ((verdict.kind is Kind.FAIL), 1 + is_second) == (bool(is_fail), count)


@pytest.mark.lab
@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.95])
def test_the_promised_rate_of_false_alarms_holds_for_two_presses(correlation: float) -> None:
    """Over many fits, sound pieces fail at most as often as promised, whatever two presses have in common."""
    rng = np.random.default_rng(1)
    alarms = []
    for _ in range(40):
        threshold = limit(known(rng, correlation=correlation).sound)
        new = sound_scores(rng, 400, 2, correlation)
        fails, _ = two_presses(threshold, threshold + 0.7, new[:, 0], new[:, 1])
        alarms.append(float(np.mean(fails)))
        assert not fails[new[:, 0] <= threshold].any()
    assert float(np.mean(alarms)) <= ALPHA


@pytest.mark.lab
def test_what_is_planned_comes_true() -> None:
    """Presses a piece, false alarms and misses on new pieces are those that the plan states, on average over fits."""
    rng = np.random.default_rng(2)
    stated, seen = [], []
    for _ in range(40):
        threshold, found = planned(rng)
        if found.bound is None:
            continue
        sound = sound_scores(rng, 4000, 2, 0.3)
        fails, presses = two_presses(threshold, found.bound, sound[:, 0], sound[:, 1])
        size = rng.choice(SIZES, 4000)
        damaged = rng.standard_normal((4000, 2)) + size[:, None]
        found_damaged, presses_damaged = two_presses(threshold, found.bound, damaged[:, 0], damaged[:, 1])
        stated.append((found.presses, found.false_alarms[1], found.misses[1]))
        mixed = 0.99 * presses.mean() + 0.01 * presses_damaged.mean()
        seen.append((mixed, fails.mean(), 1 - found_damaged.mean()))
    planned_rates, true_rates = np.mean(stated, axis=0), np.mean(seen, axis=0)

    assert len(stated) > 20
    assert planned_rates[0] == pytest.approx(true_rates[0], abs=0.02)
    assert planned_rates[1] == pytest.approx(true_rates[1], abs=0.012)
    assert planned_rates[2] == pytest.approx(true_rates[2], abs=0.03)


def test_a_second_press_saves_false_alarms_for_few_presses() -> None:
    """Where presses of a piece differ, false alarms fall to less than half for a few per cent more presses."""
    _, found = planned(np.random.default_rng(3), replace(COSTS, missed=100), correlation=0.1)

    assert found.bound is not None
    assert found.false_alarms[1] < 0.5 * found.false_alarms[0]
    assert 1 < found.presses < 1.06
    assert found.misses[1] >= found.misses[0]


RNG = np.random.default_rng(4)
KNOWN, DAMAGED = known(RNG), damaged_scores(RNG, 20)
NEVER = {
    "dear presses": (KNOWN, replace(COSTS, press=1e6), "costs more than the false alarms that it saves"),
    "dear misses": (KNOWN, replace(COSTS, missed=1e9), "costs more than the false alarms that it saves"),
    "free false alarms": (KNOWN, replace(COSTS, false_alarm=0), "costs more than the false alarms"),
    "one press each": (KnownScores(((0.5,),) * 30, DAMAGED), COSTS, "no piece was pressed twice"),
    "one piece": (KnownScores(((1.0, 2.0),), DAMAGED), COSTS, ""),
    "no damage above": (replace(KNOWN, damaged=((0.1, 0.2), ())), COSTS, "no rendered damage"),
    "no spread": (KnownScores(((1.0, 1.0), (1.0, 1.0)), ((3.0, 3.0),)), COSTS, ""),
}


@pytest.mark.parametrize("name", NEVER)
def test_it_is_never_asked_for_where_it_does_not_pay_or_too_little_is_known(name: str) -> None:
    scores, costs, why = NEVER[name]
    found = plan(scores, 2.0, ALPHA, costs)
    assert (found.bound, found.presses) == (None, 1)
    assert why in found.why


def test_the_bound_rises_with_the_cost_of_a_false_alarm() -> None:
    """The dearer a false alarm, the more presses are worth it."""
    bounds = []
    for cost in (20.0, 200.0, 2000.0):
        _, found = planned(np.random.default_rng(5), replace(COSTS, false_alarm=cost))
        bounds.append(-math.inf if found.bound is None else found.bound)

    assert bounds == sorted(bounds)
    assert bounds[-1] > bounds[0]


def test_a_second_press_saves_little_where_presses_of_a_piece_are_alike() -> None:
    """A second press of the same piece would say what the first said."""
    rng = np.random.default_rng(8)
    found = replace(known(rng), sound=tuple((s, s + 1e-12) for s in rng.standard_normal(60).tolist()))
    done = plan(found, 1.7, ALPHA, replace(COSTS, missed=10))

    assert done.false_alarms[1] == pytest.approx(done.false_alarms[0], rel=0.1)


@pytest.mark.parametrize(
    ("verdict", "bound", "expected"),
    [
        (decide(0.5, 1.0), 2.0, False),  # a pass stays a pass
        (decide(1.5, 1.0), 2.0, True),
        (decide(2.5, 1.0), 2.0, False),
        (decide(1.5, 1.0), None, False),
        (Verdict(Kind.UNSURE, 0.989, 1.0, 0.01), 2.0, False),  # not for its score: too much is not judged
        (Verdict(Kind.UNSURE, 0.991, 1.0, 0.01), 2.0, True),  # rounding decides whether it passes
        (Verdict(Kind.UNSURE, 1.009, 1.0, 0.01), 2.0, True),
    ],
)
def test_a_press_just_above_the_limit_asks(verdict: Verdict, bound: float | None, expected: bool) -> None:
    """On both sides of the threshold within its tolerance; what is far above fails at once."""
    assert is_asked(verdict, bound) is expected


def test_a_press_that_asks_is_unsure() -> None:
    assert unsure(decide(1.5, 1.0, 0.01)) == Verdict(Kind.UNSURE, 1.5, 1.0, 0.01)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [(1.5, 0.9, Kind.PASS), (1.5, 1.3, Kind.FAIL), (1.5, 9.0, Kind.FAIL), (1.5, 1.005, Kind.UNSURE)],
)
def test_the_lower_of_two_scores_is_decided(first: float, second: float, expected: Kind) -> None:
    """The verdict keeps the second press's own score."""
    verdict = second_verdict(NARROW(second), first, None, NARROW)

    assert (verdict.kind, verdict.score) == (expected, second)


def test_a_press_that_does_not_pass_for_another_reason_does_not_pass_by_the_rule() -> None:
    """Where too much of a press is not judged, its low score is no pass, and a second press would not help."""
    blind = Verdict(Kind.UNSURE, 0.5, 1.0, 0.01)

    assert second_verdict(blind, 1.5, None, NARROW).kind is Kind.UNSURE


@pytest.mark.parametrize("own", [1.3, 1.005, 0.97])
@pytest.mark.parametrize(("both", "kind"), [(0.8, Kind.PASS), (1.02, Kind.FAIL), (1.0, Kind.UNSURE)])
def test_what_both_show_is_decided_and_is_the_score(own: float, both: float, kind: Kind) -> None:
    """Whether the second press alone lies above the threshold, at it or below."""
    verdict = second_verdict(NARROW(own), 1.5, both, NARROW)

    assert (verdict.kind, verdict.score) == (kind, both)


def seen(scores: list[float], judged: list[bool] | None = None) -> SeenScores:
    """A map of one row."""
    return SeenScores(np.array([scores], np.float32), np.array([judged or [True] * len(scores)]))


@pytest.mark.parametrize(
    ("first", "second", "together"),
    [
        (seen([0.2, 1.1, 0.4]), seen([0.3, 1.0, 0.2]), 1.0),
        (seen([0.2, 1.1, 0.4]), seen([1.1, 0.5, 0.2]), 0.5),
        # What one press does not judge is decided by the other, and what none judges not at all.
        (seen([0.2, 1.1, 0.4]), seen([0.3, 0.0, 0.2], [True, False, True]), 1.1),
        (seen([0.2, 9.0, 0.4], [True, False, True]), seen([0.3, 9.0, 0.2], [True, False, True]), 0.2),
    ],
)
def test_two_presses_show_together_what_both_show_at_one_place(
    first: SeenScores, second: SeenScores, together: float
) -> None:
    for one, other in ((first, second), (second, first)):
        assert score_both(one, other) == pytest.approx(together / AGREED)


def test_what_cannot_be_is_refused() -> None:
    """Costs that cannot be, a second press without a score, and two presses that judge no place."""
    for change, words in (({"press": -1}, "not negative"), ({"defect_rate": 2}, "a share")):
        with pytest.raises(ValueError, match=words):
            replace(COSTS, **change)
    with pytest.raises(ValueError, match="without a score"):
        second_verdict(Verdict.rejected(Rejection(Reason.BLACK, Sentence("no light"))), 1.5, None, NARROW)
    with pytest.raises(ValueError, match="no place"):
        score_both(seen([1.0], [False]), seen([1.0], [False]))


def test_damage_at_the_threshold_passes_and_is_no_damage_above_it() -> None:
    sound = tuple((0.1 * n, 0.1 * n + 0.05) for n in range(1, 9))
    at, above = (plan(KnownScores(sound, ((score,),)), 1.0, ALPHA, COSTS) for score in (1.0, 1.01))
    assert at.why.startswith("no rendered damage of the fit lies above the threshold")
    assert not above.why.startswith("no rendered damage")
