"""The Pareto front of accuracy and time, decided beyond the noise of the times.

The rule. Accuracy has no noise between two runs: presses, seeds and pieces are the same. Time has. A point is *surely
faster* than another when the ratio of their times is below 1 - MARGIN in 97.5 % of the replicates, which draw the same
rounds for both. A point is dominated when another one is at least as accurate and surely faster, or more accurate and
not surely slower. The front has the points that no other point dominates.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["MARGIN", "find_dominators"]

MARGIN: Final = 0.02
"""A difference of 2 % of a press's time is no difference: runs on one machine differ by about that."""

SURE: Final = 97.5
"""Per cent of the replicates that must agree: one tail of a 95 % interval."""

Float = NDArray[np.float64]


def find_dominators(accuracy: Float, ratios: Float) -> list[list[int]]:
    """Return for each point the points that dominate it; empty on the front.

    accuracy: float64 (n,), NaN where undefined: such a point is dominated by every point with a value. ratios: float64
    (replicates, n), times of all points in the same replicates.
    """
    value = np.where(np.isnan(accuracy), -np.inf, accuracy)
    faster = _surely_faster(ratios)
    is_no_worse, is_better = value[:, None] >= value[None], value[:, None] > value[None]
    dominates = (is_no_worse & faster) | (is_better & ~faster.T)
    np.fill_diagonal(dominates, False)
    return [np.flatnonzero(dominates[:, k]).tolist() for k in range(len(value))]


def _surely_faster(ratios: Float) -> NDArray[np.bool_]:
    """[q, p]: whether q is surely faster than p."""
    return np.stack(
        [
            np.percentile(ratios[:, q, None] / ratios, SURE, axis=0) < 1 - MARGIN
            for q in range(ratios.shape[1])
        ]
    )
