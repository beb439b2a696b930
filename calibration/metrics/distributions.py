"""Probabilities of the F and t distributions: what the tables need, in float64.

Ref: Press et al., Numerical Recipes, 3rd edition, 6.4: the incomplete beta function by its continued fraction (Lentz).
"""

import math
from collections.abc import Callable
from typing import Final

__all__ = [
    "f_above",
    "t_quantile",
    "t_two_sided",
]

_STEPS: Final = 10_000
_TINY: Final = 1e-300
_EPSILON: Final = 1e-16
# Bisections of a quantile: the range is halved to the last bit of a double.
_HALVINGS: Final = 200


def f_above(value: float, df1: float, df2: float) -> float:
    """P(F > value), 0 to 1, of the F distribution. Degrees of freedom are above 0; value may be infinite."""
    if value <= 0:
        return 1.0
    if math.isinf(value):
        return 0.0
    return beta_below(df2 / (df2 + df1 * value), df2 / 2, df1 / 2)


def t_two_sided(value: float, df: float) -> float:
    """P(|t| > |value|) of Student's distribution."""
    return 0.0 if math.isinf(value) else beta_below(df / (df + value * value), df / 2, 0.5)


def t_quantile(probability: float, df: float) -> float:
    """Give the quantile of Student's distribution for a probability from 0.5 up to below 1."""
    tail = 2 * (1 - probability)
    return _root(lambda t: tail - t_two_sided(t, df), 0.0, 1e8)


def beta_below(x: float, a: float, b: float) -> float:
    """P(Beta(a, b) < x): the regularised incomplete beta function."""
    if x <= 0:
        return 0.0
    if x >= 1:
        return 1.0
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    if x < (a + 1) / (a + b + 2):
        return math.exp(log_front) * _fraction(x, a, b) / a
    return 1 - math.exp(log_front) * _fraction(1 - x, b, a) / b


def _fraction(x: float, a: float, b: float) -> float:
    """The continued fraction of the incomplete beta function."""
    c, d = 1.0, 1 / _not_zero(1 - (a + b) * x / (a + 1))
    value = d
    for m in range(1, _STEPS):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        for factor in (even, odd):
            d = 1 / _not_zero(1 + factor * d)
            c = _not_zero(1 + factor / c)
            value *= c * d
        if abs(c * d - 1) < _EPSILON * 4:
            break
    return value


def _not_zero(value: float) -> float:
    return value if abs(value) > _TINY else _TINY


def _root(rising: Callable[[float], float], low: float, high: float) -> float:
    """Find where a rising function is zero, by bisection."""
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        low, high = (middle, high) if rising(middle) < 0 else (low, middle)
    return (low + high) / 2
