"""The threshold: a conformal quantile of nominal scores with its floor, and folds that keep specimens whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.fitting.threshold import FLOOR_MARGIN, conformal_threshold, folds
from edge.core.errors import FitError


def test_nineteen_scores_promise_one_in_twenty() -> None:
    """n = 19, alpha = 0.05: rank ceil(20 x 0.95) = 19, the largest, and the floor is 1/20 exactly."""
    limit = conformal_threshold(np.arange(1.0, 20.0), 0.05)
    assert limit.value == 19.0
    assert limit.alpha_floor == pytest.approx(0.05)
    assert not limit.is_floored


@pytest.mark.parametrize(
    ("n", "alpha", "rank"), [(39, 0.05, 38), (99, 0.05, 95), (99, 0.01, 99), (4, 0.4, 3), (24, 0.44, 14)]
)
def test_the_rank_is_the_conformal_one(n: int, alpha: float, rank: int) -> None:
    """ceil((n + 1)(1 - alpha)), worked by hand; scores 1 to n in any order."""
    scores = np.random.default_rng(0).permutation(np.arange(1.0, n + 1))
    limit = conformal_threshold(scores, alpha)
    assert limit.value == rank
    assert f"rank {rank} of {n}" in limit.method


def test_below_the_floor_the_largest_score_gets_a_margin_and_says_so() -> None:
    """Ten scores cannot promise 0.05: the value is the maximum plus a quarter of its distance from the median."""
    limit = conformal_threshold(np.arange(1.0, 11.0), 0.05)
    assert limit.is_floored
    assert limit.value == 10.0 + FLOOR_MARGIN * (10.0 - 5.5)
    assert "a rate below 1/11 needs more presses" in limit.method
    assert limit.alpha_floor == pytest.approx(1 / 11)


def test_equal_scores_leave_room_for_rounding() -> None:
    """Identical presses score alike; the threshold lies above them by the numerical tolerance at least."""
    assert conformal_threshold([2.0, 2.0], 0.05, slack=0.01).value == 2.01


@pytest.mark.parametrize("scores", [[], [1.0]])
def test_fewer_than_two_scores_give_no_threshold(scores: list[float]) -> None:
    """Nothing is left to hold out; the sentence says how many presses the rate needs."""
    with pytest.raises(FitError, match=r"at least 2 \(19 for a false-alarm rate of 0.05\)"):
        conformal_threshold(scores, 0.05)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, float("nan")])
def test_a_rate_outside_nought_and_one_is_refused(alpha: float) -> None:
    """0 would need infinitely many presses."""
    with pytest.raises(FitError, match="false-alarm rate"):
        conformal_threshold([1.0, 2.0, 3.0], alpha)


def test_a_score_that_is_not_finite_is_refused() -> None:
    """NaN sorts last and would become the threshold."""
    with pytest.raises(FitError, match="not finite"):
        conformal_threshold([1.0, float("nan")], 0.05)


def test_the_promise_holds_on_average() -> None:
    """20,000 draws of 19 scores and a new one: it lies above the threshold in 5 % of the cases."""
    draws = np.random.default_rng(1).standard_normal((20_000, 20))
    limits = np.array([conformal_threshold(row, 0.05).value for row in draws[:, :19]])
    assert abs((draws[:, 19] > limits).mean() - 0.05) < 0.006  # four standard errors of the mean


@given(
    st.lists(st.sampled_from(["a", "b", "c", "d", None]), min_size=1, max_size=30),
    st.integers(1, 6),
    st.integers(0, 9),
)
@settings(max_examples=100, deadline=None)
def test_folds_hold_out_every_press_once_and_keep_specimens_whole(
    specimens: list[str | None], count: int, seed: int
) -> None:
    """The folds are a partition; presses of one specimen are never on both sides."""
    parts = folds(specimens, count, np.random.default_rng(seed))
    assert sorted(np.concatenate(parts).tolist()) == list(range(len(specimens)))
    assert 1 <= len(parts) <= count
    for part in parts:
        named = {specimens[k] for k in part} - {None}
        rest = {specimens[k] for k in range(len(specimens)) if k not in part}
        assert not named & rest


def test_folds_are_of_nearly_equal_size() -> None:
    """Twelve single presses in five folds: none holds more than three."""
    assert sorted(len(p) for p in folds([None] * 12, 5, np.random.default_rng(0))) == [2, 2, 2, 3, 3]
