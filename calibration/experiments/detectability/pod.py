"""The probability of detection by size: a log-normal curve with likelihood-ratio bounds, a90 and a90/95.

A trial is one damage at one spot of one press. Its smallest size that is found lies between a size that was missed and
one that was found: (low, high] in mm. low is 0 where the smallest size tried was found, high is infinite where the
largest was missed; so a single hit at size a is (0, a], a single miss (a, inf).

Model: POD(a) = Phi((ln a - mu) / sigma), the probit link on the logarithm of the size that MIL-HDBK-1823A (2009),
appendix G, and ASTM E2862 use for hit/miss data; ASTM E3023 is the practice for signals. The likelihood of an interval
is POD(high) - POD(low) (interval-censored data: Meeker and Escobar, Statistical Methods for Reliability Data, 1998,
chapter 7). Bounds are those of MIL-HDBK-1823A: all curves whose log-likelihood is within half of the chi-square
quantile of the best.

The log-likelihood is concave in (1 / sigma, mu / sigma), for the normal distribution is log-concave. So with a90 held
it is concave in 1 / sigma, and its maximum over 1 / sigma has one peak in ln a90: two nested searches along a line
find the global maximum.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from edge.core.arrays import F64
from edge.model.detectability import State

__all__ = ["MIN_TRIALS", "Pod", "fit_pod"]

MIN_TRIALS = 4
"""With fewer trials the bound says nothing: of three, each found, every curve is possible."""

Z90 = float(special.ndtri(0.9))

BOUND = float(special.chdtri(1, 0.1)) / 2
"""Half of the 0.90 quantile of chi-square with one degree of freedom: a one-sided bound of 95 %."""

# Slopes 1 / sigma that are tried: from a curve that is flat over all sizes to one that is a step.
_SLOPES = (math.log(1e-4), math.log(2e3))
# ln a90 is looked for this far beyond the sizes tried.
_BEYOND = math.log(50.0)
# Ever finer grids of slopes between the neighbours of the best: a ten-thousandth is left.
_POINTS = (49, 13, 13, 13, 13)


@dataclass(frozen=True)
class Pod:
    """The probability of detection at one place, or over several.

    trials, found: how many, and in how many some size was found. median_mm, sigma: of the curve, None without one.
    """

    trials: int
    found: int
    state: State
    """`separated` where one size parts all misses from all finds, so that a90 is only known to lie between two sizes
    and the upper one is given; `blind` where no size was found; `too few` trials for a curve."""
    a90_mm: float | None = None
    """The size found in 90 % of cases, its best estimate."""
    a90_95_mm: float | None = None
    """Its upper bound, 95 % sure. Each is None where it lies beyond the largest size tried."""
    median_mm: float | None = None
    sigma: float | None = None


def fit_pod(low: Sequence[float], high: Sequence[float], largest_mm: float) -> Pod:
    """Fit the curve of trials (low, high] in mm; largest_mm: the largest size tried: nothing is claimed beyond it.

    Errors: ValueError for intervals that are empty or no sizes.
    """
    ends = np.array([low, high], np.float64)
    if ends.ndim != 2 or not (ends[0] >= 0).all() or not (ends[0] < ends[1]).all():
        raise ValueError("a trial is an interval (low, high] of sizes in mm, 0 <= low < high")
    if not np.isfinite(ends[0]).all():
        raise ValueError("the largest size that was missed is finite")
    trials, hits = len(low), int(np.isfinite(ends[1]).sum())
    if trials < MIN_TRIALS or hits == 0:
        return Pod(trials, hits, "too few" if trials < MIN_TRIALS else "blind")
    different, counts = np.unique(ends, axis=1, return_counts=True)
    with np.errstate(divide="ignore"):
        logs = np.log(different)

    def likelihood(x90: float) -> float:
        return _steepest(logs, counts, x90)[1]

    if logs[0].max() < (first_found := float(logs[1].min())):  # a step explains every trial
        bound = _within(_upper(likelihood, first_found, 0.0), largest_mm)
        return Pod(trials, hits, "separated", _within(first_found, largest_mm), bound)
    known = logs[np.isfinite(logs)]
    limits = float(known.min()) - _BEYOND, float(known.max()) + _BEYOND
    best = optimize.minimize_scalar(
        lambda x: -likelihood(x), bounds=limits, method="bounded", options={"xatol": 1e-7}
    )
    x90 = float(best.x)
    bound = _within(_upper(likelihood, x90, -float(best.fun)), largest_mm)
    slope, _ = _steepest(logs, counts, x90)
    median = math.exp(x90 - Z90 / slope)
    return Pod(trials, hits, "fitted", _within(x90, largest_mm), bound, median, 1 / slope)


def _steepest(logs: F64, counts: NDArray[np.int64], x90: float) -> tuple[float, float]:
    """The best slope 1 / sigma of a curve through 0.9 at ln a90 = x90, and its log-likelihood.

    logs: ln of the ends of different intervals, (2, n). counts: how many trials have each, (n,).
    """
    first, last = _SLOPES
    for points in _POINTS:
        slopes = np.linspace(first, last, points)
        low, high = np.exp(slopes)[None, :, None] * (logs[:, None] - x90) + Z90
        flipped = low + high > 0
        above = special.log_ndtr(np.where(flipped, -low, high))
        below = special.log_ndtr(np.where(flipped, -high, low))
        with np.errstate(divide="ignore"):
            values = (above + np.log(-np.expm1(np.minimum(below - above, 0.0)))) @ counts
        k = int(values.argmax())
        first, last = slopes[max(k - 1, 0)], slopes[min(k + 1, points - 1)]
    return math.exp(slopes[k]), float(values[k])


def _upper(likelihood: Callable[[float], float], x90: float, best: float) -> float:
    """The largest ln a90 of a curve that the trials do not reject; infinite where they reject none."""
    last = x90 + 2 * _BEYOND
    if likelihood(last) >= best - BOUND:
        return math.inf
    if likelihood(x90) < best - BOUND:
        return x90
    return float(optimize.brentq(lambda x: likelihood(x) - best + BOUND, x90, last, xtol=1e-9))


def _within(log_size: float, largest_mm: float) -> float | None:
    size_mm = math.exp(log_size)
    return size_mm if size_mm <= largest_mm * (1 + 1e-9) else None
