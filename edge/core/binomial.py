"""Exact binomial limits: the highest rate of alarms that a number of trials with k alarms allows.

Ref: Clopper and Pearson, Biometrika 26 (1934). A threshold that k of n scores exceed has the same limit: the rate above
the (n - k)-th smallest of n exchangeable scores has the distribution Beta(k + 1, n - k), whatever the scores (Vovk,
Conditional validity of inductive conformal predictors, 2012). So it holds for a threshold chosen from the scores, too.
"""

import math

__all__ = ["CONFIDENCE", "beta_quantile", "rate_limits", "trials_needed", "upper_rate"]

CONFIDENCE = 0.9
"""The probability with which a limit holds, over sets of presses."""

# A term that is this share of a sum changes it no more.
_NOTHING = 1e-17


def upper_rate(alarms: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """The rate that is exceeded with probability 1 - confidence at most, after `alarms` of `trials`, 0 to 1."""
    if not 0 <= alarms <= trials:
        raise ValueError(f"alarms are 0 to {trials}, found {alarms}")
    return 1.0 if alarms == trials else beta_quantile(confidence, alarms + 1, trials - alarms)


def rate_limits(alarms: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """The rates of which each is crossed with probability 1 - confidence at most."""
    return 1 - upper_rate(trials - alarms, trials, confidence), upper_rate(alarms, trials, confidence)


def trials_needed(rate: float, alarms: int, confidence: float = CONFIDENCE) -> int:
    """The least number of trials that, with this number of alarms, have an upper rate of `rate` at most."""
    if not (0 < rate < 1 and 0 < confidence < 1):
        raise ValueError(f"rate and confidence lie between 0 and 1, found {rate} and {confidence}")
    low, high = alarms, max(2 * alarms, 1)
    while not _is_shown(rate, alarms, high, confidence):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _is_shown(rate, alarms, middle, confidence) else (middle, high)
    return high


def _is_shown(rate: float, alarms: int, trials: int, confidence: float) -> bool:
    return trials > alarms and _beta_below(rate, alarms + 1, trials - alarms) >= confidence


def beta_quantile(probability: float, a: int, b: int) -> float:
    """Find a quantile of the beta distribution with integer parameters, by bisection; to 1e-12."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if _beta_below(middle, a, b) < probability else (low, middle)
    return (low + high) / 2


def _beta_below(x: float, a: int, b: int) -> float:
    """P(Beta(a, b) <= x) as P(Binomial(a + b - 1, x) >= a), 0 < x < 1."""
    n = a + b - 1
    return _binomial_tail(a, n, x) if a >= n * x else 1 - _binomial_tail(b, n, 1 - x)


def _binomial_tail(least: int, n: int, x: float) -> float:
    """P(Binomial(n, x) >= least) from its mean on, where each term is smaller than the one before: some sqrt(n) count.

    The station asks while presses prove a bundle on a new gel, at each of them.
    """
    ways = math.lgamma(n + 1) - math.lgamma(least + 1) - math.lgamma(n - least + 1)
    term = total = math.exp(ways + least * math.log(x) + (n - least) * math.log1p(-x))
    for k in range(least, n):
        term *= (n - k) / (k + 1) * x / (1 - x)
        total += term
        if term < _NOTHING * total:
            break
    return total
