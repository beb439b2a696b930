"""The probability of detection by size: the curve, its bound, and what is said where there is no curve."""

import math

import numpy as np
import pytest
from scipy import optimize, special, stats

from calibration.experiments.detectability.pod import MIN_TRIALS, fit_pod
from edge.core.arrays import F64

LADDER = np.geomspace(0.008, 0.4, 33)


def brackets(n: int, median_mm: float, sigma: float, seed: int) -> tuple[list[float], list[float]]:
    """n smallest sizes found, drawn from a log-normal curve, between two steps of the ladder."""
    drawn = np.random.default_rng(seed).lognormal(math.log(median_mm), sigma, n)
    above = np.searchsorted(LADDER, drawn)
    ends = np.concatenate([[0.0], LADDER, [math.inf]])
    return ends[above].tolist(), ends[above + 1].tolist()


def oracle(low: F64, high: F64, a90: float, sigma: float) -> float:
    """The log-likelihood as the textbook writes it: sum of ln(Phi(high) - Phi(low))."""
    curve = stats.norm(math.log(a90) - sigma * stats.norm.ppf(0.9), sigma)
    with np.errstate(divide="ignore"):
        return float(np.log(curve.cdf(np.log(high)) - curve.cdf(np.log(low))).sum())


@pytest.mark.parametrize("seed", range(4))
def test_a90_is_where_a_general_optimiser_finds_it(seed: int) -> None:
    """The nested search gives the maximum that Nelder and Mead find over both parameters."""
    low, high = brackets(12, 0.06, 0.6, seed)
    ends = np.array(low), np.array(high)
    best = optimize.minimize(
        lambda p: -oracle(*ends, math.exp(p[0]), math.exp(p[1])),
        [math.log(0.1), math.log(0.5)],
        method="Nelder-Mead",
        options={"xatol": 1e-8, "fatol": 1e-10},
    )
    found = fit_pod(low, high, 0.4)
    assert found.a90_mm == pytest.approx(math.exp(best.x[0]), rel=1e-3)
    assert found.sigma == pytest.approx(math.exp(best.x[1]), rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_the_bound_is_the_edge_of_the_likelihood_region(seed: int) -> None:
    """a90/95 by a brute-force grid: the largest a90 with any spread within half of chi-square(1) at 0.90."""
    low, high = brackets(10, 0.05, 0.4, seed)
    ends = np.array(low), np.array(high)
    a90s = np.geomspace(0.03, 0.4, 600)
    sigmas = np.geomspace(0.05, 3, 200)
    curves = stats.norm(np.log(a90s)[:, None] - sigmas * stats.norm.ppf(0.9), sigmas)
    with np.errstate(divide="ignore"):
        total = sum(
            np.log(curves.cdf(math.log(b)) - curves.cdf(math.log(a) if a else -math.inf))
            for a, b in zip(*ends, strict=True)
        )
    profile = total.max(axis=1)
    region = a90s[profile >= profile.max() - stats.chi2.ppf(0.9, 1) / 2]
    found = fit_pod(low, high, 1.0)
    assert found.a90_95_mm == pytest.approx(region.max(), rel=0.01)
    assert found.a90_mm is not None
    assert found.a90_mm < region.max()


def test_single_hits_and_misses_are_trials_too() -> None:
    """Plain hit/miss data: probit regression on ln size, against a general optimiser."""
    sizes = np.repeat(np.geomspace(0.01, 0.2, 8), 8)
    hits = np.random.default_rng(3).random(64) < stats.norm.cdf(np.log(sizes / 0.05) / 0.5)
    low, high = np.where(hits, 0.0, sizes), np.where(hits, sizes, math.inf)

    def misfit(p: F64) -> float:
        z = p[0] + p[1] * np.log(sizes)
        return float(-np.where(hits, special.log_ndtr(z), special.log_ndtr(-z)).sum())

    best = optimize.minimize(
        misfit, [6.0, 2.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}
    )
    expected = math.exp((stats.norm.ppf(0.9) - best.x[0]) / best.x[1])
    assert fit_pod(low.tolist(), high.tolist(), 1.0).a90_mm == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("low", "high", "largest", "state", "a90"),
    [
        # A step between 0.05 and 0.06 explains every trial: a90 is its upper end.
        ([0.05] * 8, [0.06] * 8, 0.4, "separated", pytest.approx(0.06)),
        # Found twice at the largest size and missed there six times: no step, and no a90 within the sizes.
        ([0.142] * 2 + [0.16] * 6, [0.16] * 2 + [math.inf] * 6, 0.16, "fitted", None),
        # Half of the damage is never found.
        ([0.02] * 4 + [0.4] * 4, [0.025] * 4 + [math.inf] * 4, 0.4, "fitted", None),
        ([0.4] * 8, [math.inf] * 8, 0.4, "blind", None),
        ([0.01] * (MIN_TRIALS - 1), [0.02] * (MIN_TRIALS - 1), 0.4, "too few", None),
    ],
)
def test_what_no_curve_fits_is_said(
    low: list[float], high: list[float], largest: float, state: str, a90: object
) -> None:
    """No size beyond the largest is claimed, and nothing of few trials. The bound of a step lies above it."""
    found = fit_pod(low, high, largest)
    assert (found.state, found.a90_mm) == (state, a90)
    if state == "separated":
        assert found.median_mm is None
        assert found.a90_95_mm is not None
        assert 0.06 < found.a90_95_mm < 0.1
    else:
        assert found.a90_95_mm is None


def test_twelve_hits_at_one_size_do_not_show_it_and_thirteen_do() -> None:
    """With every trial a hit at the smallest size, 0.9^n < exp(-2.71 / 2) from n = 13 on (likelihood ratio)."""
    assert fit_pod([0.0] * 12, [0.01] * 12, 0.4).a90_95_mm is None
    assert fit_pod([0.0] * 13, [0.01] * 13, 0.4).a90_95_mm is not None


def test_the_bound_holds_as_often_as_it_says() -> None:
    """Of 100 sets of eight trials the true a90 is below a90/95 in at least 90 %: nearly the 95 % of large sets."""
    true = 0.05 * math.exp(0.35 * stats.norm.ppf(0.9))
    bounds = [fit_pod(*brackets(8, 0.05, 0.35, seed), 0.4).a90_95_mm or math.inf for seed in range(100)]
    assert np.mean(np.array(bounds) >= true) >= 0.9


@pytest.mark.parametrize(
    ("low", "high"), [([0.2], [0.1]), ([-0.1], [0.1]), ([math.inf], [math.inf]), ([0.1], [0.1])]
)
def test_intervals_that_are_none_are_refused(low: list[float], high: list[float]) -> None:
    with pytest.raises(ValueError, match="low, high"):
        fit_pod(low, high, 0.4)
