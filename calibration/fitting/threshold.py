"""The threshold, from nominal presses alone: out-of-fold scores and a conformal quantile with its floor stated.

Ref: Vovk, Gammerman, Shafer, Algorithmic Learning in a Random World (2005), section 2 (the quantile); Vovk,
Cross-conformal predictors, Annals of Mathematics and AI 74 (2015) (scores from folds). For n exchangeable scores, the
ceil((n + 1)(1 - alpha))-th smallest is exceeded by a new nominal press with probability alpha at most. With folds the
promise is approximate and errs on the quiet side: a fold knows fewer presses than the bank, so its scores are higher.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import FitError
from edge.model.manifest import ThresholdEntry

__all__ = ["FLOOR_MARGIN", "check_alpha", "conformal_threshold", "folds"]

FLOOR_MARGIN = 0.25
"""Where n presses cannot promise the rate asked for, the largest score is raised by this share of the distance from
the median to it. A choice, not a theorem: it trades some sensitivity for fewer false alarms."""

MIN_SCORES = 2


def conformal_threshold(
    scores: Sequence[float] | NDArray[np.float64],
    alpha: float,
    slack: float = 0.0,
    kind: str = "cross-conformal",
) -> ThresholdEntry:
    """The threshold at which a nominal press fails with probability alpha at most, if n allows it.

    scores: anomaly scores of nominal presses that the scoring bank did not know. slack: smallest margin above the
    largest score where the floor holds; the numerical tolerance. kind: how the scores came about, for the record.
    Errors: FitError for fewer than two scores.
    """
    check_alpha(alpha)
    ordered = np.sort(np.asarray(scores, np.float64))
    n = len(ordered)
    if n < MIN_SCORES:
        raise FitError(
            f"{n} nominal press gives no threshold, since nothing is left to hold out; give at least {MIN_SCORES} "
            f"({math.ceil(1 / alpha) - 1} for a false-alarm rate of {alpha:g}), or state a threshold yourself"
        )
    if not np.isfinite(ordered).all():
        raise FitError("a nominal press has a score that is not finite; look at the pictures")
    floor = 1 / (n + 1)
    # In exact arithmetic (n + 1) alpha may be a whole number that floats miss by a hair.
    rank = math.ceil((n + 1) * (1 - alpha) - 1e-9)
    if rank <= n:
        value, method = float(ordered[rank - 1]), f"{kind} quantile, rank {rank} of {n}"
    else:
        margin = max(FLOOR_MARGIN * float(ordered[-1] - np.median(ordered)), slack)
        value = float(ordered[-1]) + margin
        method = f"{kind}: largest of {n} scores plus {margin:.4g}: a rate below 1/{n + 1} needs more presses"
    return ThresholdEntry(
        value=value, method=method, alpha=alpha, alpha_floor=floor, nominal_scores=tuple(map(float, ordered))
    )


def check_alpha(alpha: float) -> None:
    """Errors: FitError for a false-alarm rate that is none."""
    if not 0 < alpha < 1:
        raise FitError(f"the false-alarm rate lies between 0 and 1, found {alpha}; 0.05 is one in twenty")


def folds(specimens: Sequence[str | None], count: int, rng: np.random.Generator) -> list[NDArray[np.int64]]:
    """Indices of the presses held out in each fold: every press once, a specimen never on both sides.

    Presses without a specimen stand for themselves. At most `count` folds, at most one per group.
    """
    keys = [f"press {k}" if name is None else f"specimen {name}" for k, name in enumerate(specimens)]
    groups = sorted(set(keys))
    order = rng.permutation(len(groups))
    fold_of = {groups[g]: position % count for position, g in enumerate(order)}
    assigned = np.array([fold_of[key] for key in keys])
    return [held for k in range(count) if len(held := np.flatnonzero(assigned == k))]
