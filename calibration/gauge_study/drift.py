"""Whether the scores drift while a study runs: the gel wears with every press.

Piece and operator are taken out, and what is left is a line over the order of the presses: analysis of covariance with
a mean of its own for each cell. The slope's t test is exact for normal errors.
"""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.metrics.distributions import t_quantile, t_two_sided

__all__ = ["Drift", "drift"]

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Drift:
    """Of the score from the first press to the last. low, high: 95 % interval of `total`. p: probability of such a
    slope without a drift. sd: of one score around the line."""

    total: float
    low: float
    high: float
    p: float
    sd: float
    presses: int

    @property
    def is_found(self) -> bool:
        return self.p < 0.05


def drift(scores: Sequence[float], cells: Sequence[Hashable], order: Sequence[int]) -> Drift | None:
    """scores, the cell (piece and operator) and the place in the order of each press. None where the order cannot be
    separated from the cells."""
    y, t = np.asarray(scores, np.float64), np.asarray(order, np.float64)
    inside_y, inside_t = _inside(y, cells), _inside(t, cells)
    spread = float(inside_t @ inside_t)
    df = len(y) - len(set(cells)) - 1
    if df < 1 or spread <= 0:
        return None
    slope = float(inside_t @ inside_y) / spread
    rest = inside_y - slope * inside_t
    sd = math.sqrt(float(rest @ rest) / df)
    error, length = sd / math.sqrt(spread), float(np.ptp(t))
    half = t_quantile(0.975, df) * error * length
    p = t_two_sided(slope / error, df) if error > 0 else float(slope == 0)
    return Drift(slope * length, slope * length - half, slope * length + half, p, sd, len(y))


def _inside(values: F64, cells: Sequence[Hashable]) -> F64:
    """Without the mean of its cell."""
    number = {cell: n for n, cell in enumerate(dict.fromkeys(cells))}
    index = np.array([number[cell] for cell in cells])
    means = np.bincount(index, values) / np.bincount(index)
    return np.asarray(values - means[index])
