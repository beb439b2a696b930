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
find the global maximum, and need no library.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["MIN_TRIALS", "Pod", "State", "fit_pod", "log_likelihood"]

F64 = NDArray[np.float64]
State = Literal["fitted", "separated", "blind", "too few"]

MIN_TRIALS = 4
"""With fewer trials the bound says nothing: of three, each found, every curve is possible."""

Z90 = 1.2815515655446004
"""Phi(Z90) = 0.9."""

BOUND = 2.705543454095404 / 2
"""Half of the 0.90 quantile of chi-square with one degree of freedom: a one-sided bound of 95 %."""

# Slopes 1 / sigma that are tried: from a curve that is flat over all sizes to one that is a step.
_SLOPES = (math.log(1e-4), math.log(2e3))
# ln a90 is looked for this far beyond the sizes tried.
_BEYOND = math.log(50.0)
# Golden section: a millionth of the range is left.
_STEPS = 34
# Ever finer grids of slopes between the neighbours of the best: a ten-thousandth is left.
_POINTS = (49, 13, 13, 13, 13)
_GOLDEN = (math.sqrt(5) - 1) / 2


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
    """The curve of trials (low, high] in mm; largest_mm: the largest size tried, beyond which nothing is claimed.

    Errors: ValueError for intervals that are empty or no sizes.
    """
    intervals = _check_intervals(low, high)
    trials, found = len(low), int(np.isfinite(intervals[1]).sum())
    if trials < MIN_TRIALS:
        return Pod(trials, found, "too few")
    if found == 0:
        return Pod(trials, found, "blind")
    counted = _Counted.of(intervals)
    x90, best, state = _peak(counted)
    slope, _ = _steepest(counted, x90)
    median = None if state == "separated" else math.exp(x90 - Z90 / slope)
    return Pod(
        trials,
        found,
        state,
        _within(math.exp(x90), largest_mm),
        _within(math.exp(_upper(counted, x90, best)), largest_mm),
        median,
        None if state == "separated" else 1 / slope,
    )


@dataclass(frozen=True, eq=False)
class _Counted:
    """Different intervals, ln of their ends (2, n), and how many trials have each, (n,)."""

    logs: F64
    counts: F64

    @classmethod
    def of(cls, intervals: F64) -> "_Counted":
        different, counts = np.unique(intervals, axis=1, return_counts=True)
        with np.errstate(divide="ignore"):
            return cls(np.log(different), counts.astype(np.float64))


def log_likelihood(low: Sequence[float], high: Sequence[float], a90_mm: float, sigma: float) -> float:
    """Return the log likelihood of trials (low, high] by the curve of this a90 and spread of ln size."""
    found = _log_likelihoods(
        _Counted.of(_check_intervals(low, high)), math.log(a90_mm), np.array([1 / sigma])
    )
    return float(found[0])


def _log_likelihoods(trials: _Counted, x90: float, slopes: F64) -> F64:
    """Return the log likelihoods of curves through 0.9 at ln a90 = x90 with 1 / sigma = slopes, (m,)."""
    low, high = slopes[None, :, None] * (trials.logs[:, None] - x90) + Z90
    flipped = low + high > 0
    below, above = np.where(flipped, -high, low), np.where(flipped, -low, high)
    upper = _log_ndtr(above)
    with np.errstate(divide="ignore"):
        each = upper + np.log(-np.expm1(np.minimum(_log_ndtr(below) - upper, 0.0)))
    return np.asarray(each @ trials.counts)


def _check_intervals(low: Sequence[float], high: Sequence[float]) -> F64:
    intervals = np.array([low, high], np.float64)
    if intervals.ndim != 2 or not (intervals[0] >= 0).all() or not (intervals[0] < intervals[1]).all():
        raise ValueError("a trial is an interval (low, high] of sizes in mm, 0 <= low < high")
    if not np.isfinite(intervals[0]).all():
        raise ValueError("the largest size that was missed is finite")
    return intervals


def _peak(trials: _Counted) -> tuple[float, float, State]:
    """ln a90 of the best curve, its log-likelihood, and whether a step explains every trial."""
    logs = trials.logs
    misses, finds = float(logs[0].max()), float(logs[1].min())
    if misses < finds:
        return finds, 0.0, "separated"
    known = logs[np.isfinite(logs)]
    x90, best = _highest(lambda x: _steepest(trials, x)[1], known.min() - _BEYOND, known.max() + _BEYOND)
    return x90, best, "fitted"


def _steepest(trials: _Counted, x90: float) -> tuple[float, float]:
    """The best slope of a curve through 0.9 at x90, and its log-likelihood."""
    low, high = _SLOPES
    for points in _POINTS:
        logs = np.linspace(low, high, points)
        values = _log_likelihoods(trials, x90, np.exp(logs))
        k = int(values.argmax())
        low, high = logs[max(k - 1, 0)], logs[min(k + 1, points - 1)]
    return math.exp(logs[k]), float(values[k])


def _upper(trials: _Counted, x90: float, best: float) -> float:
    """The largest ln a90 of a curve that the trials do not reject; infinite where they reject none."""
    low, high = x90, x90 + 2 * _BEYOND
    if _steepest(trials, high)[1] >= best - BOUND:
        return math.inf
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if _steepest(trials, middle)[1] >= best - BOUND else (low, middle)
    return high


def _highest(value: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Find where a function with one peak is highest, by golden section, and how high."""
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left, at_right = value(left), value(right)
    for _ in range(_STEPS):
        if at_left < at_right:
            low, left, at_left = left, right, at_right
            right = low + _GOLDEN * (high - low)
            at_right = value(right)
        else:
            high, right, at_right = right, left, at_left
            left = high - _GOLDEN * (high - low)
            at_left = value(left)
    return (left, at_left) if at_left > at_right else (right, at_right)


def _within(size_mm: float, largest_mm: float) -> float | None:
    return size_mm if size_mm <= largest_mm * (1 + 1e-9) else None


_erfc = np.frompyfunc(math.erfc, 1, 1)


def _log_ndtr(z: F64) -> F64:
    """ln Phi(z), also far below 0, where Phi itself is 0 (Abramowitz and Stegun 26.2.12)."""
    far = z < -12
    near = np.where(far, 0.0, z)
    deep = np.where(far, z, -13.0)
    with np.errstate(over="ignore", divide="ignore"):
        inverse = 1 / (deep * deep)
        tail = -deep * deep / 2 - np.log(-deep) - math.log(2 * math.pi) / 2
        tail = tail + np.log1p(-inverse * (1 - 3 * inverse * (1 - 5 * inverse)))
        direct = np.log(np.asarray(_erfc(-near / math.sqrt(2)), np.float64) / 2)
    return np.where(far, tail, direct)
