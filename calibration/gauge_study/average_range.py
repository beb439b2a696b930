"""Gauge R&R by averages and ranges, next to the analysis of variance: what can be checked with a pocket calculator.

Ref: AIAG, Measurement Systems Analysis, 4th edition, chapter III, section B: K1, K2 and K3 are 1 / d2* of Duncan's
table. d2* is sqrt(d2^2 + d3^2 / g) for the mean range of g groups; AIAG's printed constants are rounded to four places.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["AverageRange", "by_average_and_range", "k_factor"]

F64 = NDArray[np.float64]

# The range of normal values beyond this many standard deviations adds less than 1e-15.
_REACH: Final = 9.0
_POINTS: Final = 601


@dataclass(frozen=True)
class AverageRange:
    """Standard deviations. mean_range: over the cells. upper_range: a cell with a larger range is looked at first."""

    ev: float
    av: float
    grr: float
    pv: float
    tv: float
    ndc: int
    mean_range: float
    upper_range: float
    cells_above: int

    def percent(self, name: str) -> float:
        """Of TV, by the name of the field."""
        return 100 * float(getattr(self, name)) / self.tv if self.tv > 0 else 0.0


def by_average_and_range(scores: F64) -> AverageRange:
    """scores: float64 (pieces, operators, repeats), at least two of each, finite."""
    pieces, operators, repeats = scores.shape
    ranges = np.ptp(scores, axis=2)
    mean_range = float(ranges.mean())
    ev = mean_range * k_factor(repeats, None)
    between = float(np.ptp(scores.mean(axis=(0, 2)))) * k_factor(operators, 1)
    av = math.sqrt(max(0.0, between**2 - ev**2 / (pieces * repeats)))
    pv = float(np.ptp(scores.mean(axis=(1, 2)))) * k_factor(pieces, 1)
    grr = math.hypot(ev, av)
    d2, d3 = _range_of_normal(repeats)
    upper = mean_range * (1 + 3 * d3 / d2)  # D4
    return AverageRange(
        ev=ev,
        av=av,
        grr=grr,
        pv=pv,
        tv=math.hypot(grr, pv),
        ndc=max(1, int(min(1.41 * pv / grr, 9999.0))) if grr > 0 else 9999,
        mean_range=mean_range,
        upper_range=upper,
        cells_above=int((ranges > upper).sum()),
    )


def k_factor(n: int, groups: int | None) -> float:
    """1 / d2* of ranges of n values; groups None for many, as K1 takes it. Rounded to four places, as AIAG has it."""
    d2, d3 = _range_of_normal(n)
    d2_star = d2 if groups is None else math.sqrt(d2**2 + d3**2 / groups)
    return round(1 / d2_star, 4)


@cache
def _range_of_normal(n: int) -> tuple[float, float]:
    """d2 and d3: mean and standard deviation of the range of n standard normal values (Tippett, 1925)."""
    x = np.linspace(-_REACH, _REACH, _POINTS)
    below = np.array([0.5 * math.erfc(-one / math.sqrt(2)) for one in x])
    step = float(x[1] - x[0])
    mean = float((1 - below**n - (1 - below) ** n).sum()) * step
    low, high = below[:, None], below[None, :]
    inner = 1 - high**n - (1 - low) ** n + np.clip(high - low, 0, None) ** n
    square = 2 * float(np.triu(inner, 1).sum() + 0.5 * np.trace(inner)) * step**2
    return mean, math.sqrt(square - mean**2)
