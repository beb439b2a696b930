"""The threshold: a conformal quantile of nominal scores that counts pieces, its floor, and one bundle's own rate."""

import numpy as np
import pytest
import scipy

from calibration.fitting.limits.threshold import FLOOR_MARGIN, conformal_threshold, count_needed, rate_range
from edge.core.errors import FitError


@pytest.mark.parametrize(
    ("n", "alpha", "rank"),
    [(19, 0.05, 19), (39, 0.05, 38), (99, 0.05, 95), (99, 0.01, 99), (4, 0.4, 3), (24, 0.44, 14)],
)
def test_the_rank_is_the_conformal_one(n: int, alpha: float, rank: int) -> None:
    """ceil((n + 1)(1 - alpha)), worked by hand; scores 1 to n in any order."""
    scores = np.random.default_rng(0).permutation(np.arange(1.0, n + 1))
    limit = conformal_threshold(scores, alpha)
    assert limit.value == rank
    assert f"rank {rank} of {n}" in limit.method
    assert not limit.is_floored
    assert limit.alpha_floor == pytest.approx(1 / (n + 1))


def test_below_the_floor_the_largest_score_gets_a_margin_and_says_so() -> None:
    """Ten scores cannot promise 0.05: the value is the maximum plus a quarter of its distance from the median."""
    limit = conformal_threshold(np.arange(1.0, 11.0), 0.05)
    assert limit.is_floored
    assert limit.value == 10.0 + FLOOR_MARGIN * (10.0 - 5.5)
    assert "largest of 10 scores plus" in limit.method
    assert limit.alpha_floor == pytest.approx(1 / 11)


def test_a_rate_that_is_near_needs_a_smaller_margin() -> None:
    """Sixteen scores promise 1 in 17: an exponential tail has ln(20 / 17) of ln(17 / 2) to go to 1 in 20. Of an
    exponential distribution a twentieth lies above the limit, as with one more press, and more than with a quarter."""
    limit = conformal_threshold(np.arange(1.0, 17.0), 0.05)
    assert limit.is_floored
    assert limit.value == pytest.approx(16 + np.log(20 / 17) / np.log(17 / 2) * 7.5)
    draws = np.random.default_rng(4).exponential(size=(2000, 16))
    highest, middle = draws.max(axis=1), np.median(draws, axis=1)
    values = highest + np.log(20 / 17) / np.log(17 / 2) * (highest - middle)
    assert [conformal_threshold(draw, 0.05).value for draw in draws[:20]] == pytest.approx(values[:20])
    assert np.exp(-values).mean() == pytest.approx(0.052, abs=0.004)


def test_equal_scores_leave_room_for_rounding() -> None:
    """Identical presses score alike; the threshold lies above them by the numerical tolerance at least."""
    assert conformal_threshold([2.0] * 4, 0.05, slack=0.01).value == 2.01


@pytest.mark.parametrize(
    ("scores", "alpha", "sentence"),
    [
        *(([1.0] * n, 0.05, r"give at least 4 \(19 for a false-alarm rate of 0.05\)") for n in range(4)),
        *(([1.0] * 4, alpha, "false-alarm rate") for alpha in (0.0, 1.0, -0.1, float("nan"))),
        ([1.0, 2.0, 3.0, float("nan")], 0.05, "not finite"),  # NaN sorts last and would become the threshold
    ],
)
def test_what_gives_no_threshold_is_refused(scores: list[float], alpha: float, sentence: str) -> None:
    with pytest.raises(FitError, match=sentence):
        conformal_threshold(scores, alpha)


def test_presses_count_as_pieces() -> None:
    """24 presses of 4 pieces promise 1/5 for a fifth piece, not 1/25."""
    limit = conformal_threshold(np.arange(24.0), 0.05, specimens=list("abcd" * 6))
    assert (limit.pieces, limit.n) == (4, 24)
    assert limit.alpha_floor == pytest.approx(1 / 5)
    assert limit.is_floored
    assert limit.value > 23


@pytest.mark.parametrize("pieces", ["ab", "abc"])
def test_of_fewer_than_four_pieces_nothing_is_promised_of_others(pieces: str) -> None:
    """Only how often presses of these pieces lie above the limit."""
    limit = conformal_threshold(np.arange(24.0), 0.05, specimens=list(pieces * (24 // len(pieces))))
    assert (limit.alpha_floor, limit.rate_range, limit.by_piece) == (1, None, None)
    assert limit.by_press is not None
    assert limit.value > 23


def test_each_piece_has_one_vote() -> None:
    """Worked by hand, alpha 0.4 of 4 pieces: weights up to 3 of 5. The piece pressed often, all high, counts once."""
    scores = [1.0, 2.0, 3.0, 7.0, 8.0, 9.0, 10.0]
    limit = conformal_threshold(scores, 0.4, specimens=["a", "b", "c", "d", "d", "d", "d"])
    assert limit.value == 3.0
    assert conformal_threshold(scores, 0.4).value == 8.0  # ceil(8 x 0.6) = 5 where each is a piece of its own
    # A quarter of d is missing to 3.5 of 5.
    assert conformal_threshold(scores, 0.3, specimens=["a", "b", "c", "d", "d", "d", "d"]).value == 8.0


def test_one_press_of_each_piece_is_as_if_pieces_were_unknown() -> None:
    """The weighted quantile becomes the plain one."""
    scores = np.random.default_rng(0).normal(size=30)
    names = [f"{k:03d}" for k in range(30)]
    assert conformal_threshold(scores, 0.1, specimens=names) == conformal_threshold(scores, 0.1)


@pytest.mark.lab
def test_the_promise_holds_for_new_pieces() -> None:
    """500 draws of 5 pieces with 10 presses each, alike within a piece: a press of a sixth fails in 1/6 at most.
    Counted by presses one in ten is promised and not kept: 50 presses of 5 pieces are not 50 draws."""
    rng = np.random.default_rng(2)
    draws = (rng.normal(size=(500, 5, 1)) + 0.1 * rng.normal(size=(500, 5, 10))).reshape(500, 50)
    names = [str(k // 10) for k in range(50)]
    for specimens, floor, is_kept in ((names, 1 / 6, True), ((), 1 / 51, False)):
        limits = [conformal_threshold(draw, 0.1, specimens=specimens) for draw in draws]
        promised = max(0.1, limits[0].alpha_floor)
        assert limits[0].alpha_floor == pytest.approx(floor)
        fails = scipy.stats.norm(0, 1.01**0.5).sf([limit.value for limit in limits])
        assert (fails.mean() < promised + 4 * fails.std() / 500**0.5) == is_kept


@pytest.mark.parametrize(
    ("pieces", "alpha", "shape"),
    [(60, 0.05, (3, 58)), (19, 0.05, (1, 19)), (200, 0.1, (20, 181)), (10, 0.05, (1, 10))],
)
def test_one_bundles_own_rate_is_beta_distributed(pieces: int, alpha: float, shape: tuple[int, int]) -> None:
    """The 95 % range against scipy's; Beta(n + 1 - r, r) for the r-th smallest of n scores. Above the largest score,
    which ten pieces need for 5 %, there is an upper limit alone."""
    sides = (0.025, 0.975) if pieces > 10 else (0, 0.95)
    assert rate_range(pieces, alpha) == pytest.approx(scipy.stats.beta(*shape).ppf(sides), abs=1e-9)


@pytest.mark.lab
def test_bundles_keep_the_promise_on_average_and_each_lies_in_its_range() -> None:
    """Of 1,000 bundles of 39 uniform scores 5 % of new presses lie above the threshold, to four standard errors; each
    bundle's own rate is in the stated range in 95 % of them."""
    draws = np.random.default_rng(3).uniform(size=(1000, 39))
    low, high = rate_range(39, 0.05)
    rates = np.array([1 - conformal_threshold(row, 0.05).value for row in draws])
    assert rates.mean() == pytest.approx(0.05, abs=0.0043)
    assert np.mean((low <= rates) & (rates <= high)) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(("alpha", "count"), [(0.05, 19), (0.1, 9), (0.01, 99), (0.3, 3)])
def test_how_many_pieces_a_rate_needs(alpha: float, count: int) -> None:
    """The least n with 1 / (n + 1) at most the rate."""
    assert count_needed(alpha) == count
    assert not conformal_threshold(np.arange(max(4.0, count)), alpha).is_floored


def test_one_bundle_is_promised_by_press_and_by_piece() -> None:
    """Worked by hand: the threshold is 8 and presses 9 and 10 of piece d lie above: 2 of 7 presses, 1 of 4 pieces."""
    scores = [1.0, 2.0, 3.0, 7.0, 8.0, 9.0, 10.0]
    limit = conformal_threshold(scores, 0.3, specimens=["a", "b", "c", "d", "d", "d", "d"])
    assert limit.by_press is not None
    assert limit.by_piece is not None
    assert (limit.by_press.alarms, limit.by_press.trials) == (2, 7)
    assert (limit.by_piece.alarms, limit.by_piece.trials) == (1, 4)
    assert limit.by_press.rate == pytest.approx(scipy.stats.beta(3, 5).ppf(0.9), abs=1e-9)
    assert limit.by_piece.rate == pytest.approx(scipy.stats.beta(2, 3).ppf(0.9), abs=1e-9)


def test_the_promise_of_one_bundle_lies_in_its_range() -> None:
    """The two statements of a manifest agree: the limit (90 %) is within the range (95 %). Presses of unknown pieces
    have one promise: 10 without an alarm, at most 1 - .1^(1/10)."""
    for pieces in (10, 25, 60, 200):
        limit = conformal_threshold(np.arange(float(pieces)), 0.05)
        assert limit.by_press is not None
        assert limit.rate_range is not None
        assert limit.by_piece is None
        assert pieces > 10 or limit.by_press.rate == pytest.approx(1 - 0.1 ** (1 / 10), abs=1e-9)
        assert limit.rate_range[0] < limit.by_press.rate < limit.rate_range[1]
