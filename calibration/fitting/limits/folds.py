"""Which presses are held out together: all presses of a piece where there are enough pieces."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.limits.threshold import pieces_of
from calibration.fitting.presses.nominal_presses import MIN_PRESSES

__all__ = ["LEAVE_ONE_OUT_BELOW", "MIN_PIECES", "Folds", "divide_presses", "folds"]

LEAVE_ONE_OUT_BELOW = 10
"""With fewer presses each is held out alone: a fold of two would make the bank clearly smaller."""

MIN_PIECES = 3
"""With fewer, a fold without one piece leaves a bank of one piece, which does not show how pieces differ."""

Folds = list[NDArray[np.int64]]


def divide_presses(
    specimens: Sequence[str | None], count: int, rng: np.random.Generator, fewest: int = MIN_PRESSES
) -> tuple[Folds, list[str]]:
    """Divide presses into folds, and warn where pieces are too few to hold out all presses of one.

    Each fold leaves one press less than `fewest` at least, of as many presses or more.
    """
    n, pieces = len(specimens), len(set(pieces_of(specimens)))
    count = n if n < LEAVE_ONE_OUT_BELOW else count
    found = folds(specimens, count, rng)
    if pieces >= min(MIN_PIECES, fewest) and n - max(len(held) for held in found) >= fewest - 1:
        return found, []
    warning = (
        f"the presses are of {pieces} piece{'' if pieces == 1 else 's'}, too few to hold one out: the threshold "
        f"knows nothing of other pieces; press at least {MIN_PIECES} pieces, several times each"
    )
    return folds((None,) * n, count, rng), [warning]


def folds(specimens: Sequence[str | None], count: int, rng: np.random.Generator) -> Folds:
    """Indices of the presses held out in each fold: every press once, a specimen never on both sides.

    A press without a specimen counts as its own piece. At most `count` folds, at most one per piece.
    """
    keys = pieces_of(specimens)
    groups = sorted(set(keys))
    order = rng.permutation(len(groups))
    fold_of = {groups[g]: position % count for position, g in enumerate(order)}
    assigned = np.array([fold_of[key] for key in keys])
    return [held for k in range(count) if len(held := np.flatnonzero(assigned == k))]
