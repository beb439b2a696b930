"""What a fit checks of its own work: presses that stand apart, and a black frame. See `covering` for the bank."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import FitError
from edge.model.manifest import ThresholdEntry

__all__ = ["apart_warnings", "black_warnings", "room_warnings", "standing_apart"]

APART_FACTOR, APART_PRESSES = 7.0, 8
"""With n presses one stands apart that lies APART_FACTOR (1 + APART_PRESSES / n) times as far above the median as the
upper half does on average. Sound presses have long tails, longer where few are seen, so this is no test of normality.
"""

APART_SHARE = 0.1
"""More presses than this share do not stand apart: they are another way in which sound presses look."""


def standing_apart(scores: NDArray[np.float64]) -> list[int]:
    """Which presses score far above all others, the highest first.

    scores: out-of-fold scores, (n,). Up to APART_SHARE of them, at least one, may stand apart together; each is
    compared with the presses that do not, since two would hide each other.
    """
    n = len(scores)
    order = np.argsort(scores, kind="stable")[::-1]
    for count in range(max(1, int(APART_SHARE * n)), 0, -1):
        others = scores[order[count:]]
        above = others - np.median(others)
        usual = float(above[above > 0].mean()) if (above > 0).any() else 0.0
        limit = np.median(others) + APART_FACTOR * (1 + APART_PRESSES / n) * usual
        if scores[order[count - 1]] > max(limit, others.max()):
            return [int(k) for k in order[:count]]
    return []


def apart_warnings(scores: NDArray[np.float64], names: Sequence[str]) -> list[str]:
    """A sentence for each press that stands apart."""
    apart = standing_apart(scores)
    others = np.delete(scores, apart)
    return [
        f"press '{names[k]}' stands apart from the others: {scores[k]:.4g} where they reach {others.max():.4g}; if it "
        f"is of a damaged part, damage like it passes: look at it, and fit with --leave-out '{names[k]}'"
        for k in apart
    ]


def room_warnings(room: float) -> list[str]:
    """Whether the bank is larger than the detector's parameters say."""
    if room == 1:
        return []
    return [f"the bank has {room:g} times its usual room: with less it lacks what nominal presses show"]


def black_warnings(
    score: float, limit: ThresholdEntry, is_refused: bool, apart: Sequence[str] = ()
) -> list[str]:
    """Whether a black frame, which shows no press at all, scores as a sound press does.

    score: its anomaly score. is_refused: whether its colours alone keep the gateway from scoring it. apart: what was
    said of presses that stand apart, which may be the reason.
    Errors: FitError where nothing keeps it from passing.
    """
    if score > limit.value:
        return []
    found = f"a black frame scores {score:.4g}, below the threshold of {limit.value:.4g}"
    if is_refused:
        return [f"{found}: it is refused for its colours alone"]
    why = apart or ("look for nominal pictures that are no presses, press more, or fit another method",)
    raise FitError(f"{found}, and would pass: {'; '.join(why)}")
