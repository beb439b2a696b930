"""Exact binomial limits against known numbers and scipy."""

import numpy as np
import pytest
import scipy

from edge.core.binomial import rate_limits, trials_needed, upper_rate


@pytest.mark.parametrize(
    ("rate", "confidence", "trials"),
    [(0.1, 0.9, 22), (0.1, 0.95, 29), (0.05, 0.9, 45), (0.05, 0.95, 59), (0.01, 0.9, 230), (0.01, 0.95, 299)],
)
def test_trials_without_an_alarm(rate: float, confidence: float, trials: int) -> None:
    """The published numbers of the practice (29 of 29 is 90 % at 95 %): one trial fewer does not reach the rate."""
    assert trials_needed(rate, 0, confidence) == trials
    assert upper_rate(0, trials, confidence) <= rate < upper_rate(0, trials - 1, confidence)


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.99])
@pytest.mark.parametrize(
    ("alarms", "trials"),
    [(0, 1), (0, 22), (1, 38), (3, 40), (19, 20), (12, 400), (300, 2500), (2400, 2500), (9, 100_000)],
)
def test_the_limit_is_that_of_clopper_and_pearson(alarms: int, trials: int, confidence: float) -> None:
    """Against scipy's one-sided exact limit."""
    found = scipy.stats.binomtest(alarms, trials, alternative="less").proportion_ci(
        confidence, method="exact"
    )
    assert upper_rate(alarms, trials, confidence) == pytest.approx(found.high, abs=1e-9)


@pytest.mark.parametrize(("alarms", "trials"), [(0, 100), (100, 100), (1, 38), (19, 20), (12, 400)])
def test_the_limits_on_both_sides_are_those_of_clopper_and_pearson(alarms: int, trials: int) -> None:
    """Against scipy's exact interval; without and with nothing but alarms they end at 0 and 1."""
    found = scipy.stats.binomtest(alarms, trials).proportion_ci(0.95, method="exact")
    assert rate_limits(alarms, trials, 0.975) == pytest.approx((found.low, found.high), abs=1e-9)


def test_only_alarms_promise_nothing() -> None:
    """Every trial alarmed: any rate is possible."""
    assert upper_rate(5, 5) == 1.0


@pytest.mark.parametrize(("alarms", "rate"), [(1, 0.1), (2, 0.1), (4, 0.05)])
def test_trials_with_alarms(alarms: int, rate: float) -> None:
    """The least number: with one fewer the limit is above the rate."""
    trials = trials_needed(rate, alarms)
    assert upper_rate(alarms, trials) <= rate < upper_rate(alarms, trials - 1)


@pytest.mark.parametrize(("rate", "confidence"), [(0.0, 0.9), (1.0, 0.9), (0.1, 1.0), (float("nan"), 0.9)])
def test_what_no_number_of_trials_shows_is_refused(rate: float, confidence: float) -> None:
    """A search for it would not end."""
    with pytest.raises(ValueError, match="between 0 and 1"):
        trials_needed(rate, 0, confidence)


@pytest.mark.parametrize(("alarms", "trials"), [(-1, 5), (6, 5)])
def test_more_alarms_than_trials_are_refused(alarms: int, trials: int) -> None:
    with pytest.raises(ValueError, match="alarms are 0 to 5"):
        upper_rate(alarms, trials)


@pytest.mark.parametrize("rank", [19, 20])
def test_a_threshold_from_the_scores_keeps_the_limit(rank: int) -> None:
    """4,000 sets of 20 uniform scores, the threshold at one of them: its rate is above the limit in 10 %. The
    threshold is chosen from the scores that are counted, and the limit holds all the same."""
    thresholds = np.sort(np.random.default_rng(0).uniform(size=(4000, 20)), axis=1)[:, rank - 1]
    broken = np.mean(1 - thresholds > upper_rate(20 - rank, 20))
    assert abs(broken - 0.1) < 4 * (0.09 / 4000) ** 0.5
