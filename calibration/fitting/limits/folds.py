"""Which presses are held out together: all presses of a piece, from two pieces on."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.limits.threshold import pieces_of
from calibration.fitting.presses.nominal_presses import MIN_PRESSES
from edge.model.manifest_facts import UNPROVEN

__all__ = ["Folds", "divide_presses", "folds"]

_STRETCHES = 3
"""Of a film a third is held out, all of it together: frames beside those that are learnt show nothing of other presses.
With five stretches of a rolling finger 3 of 12 other frames failed, with three 1, with frames drawn at random 8."""

LEAVE_ONE_OUT_BELOW = 10
"""With fewer presses each is held out alone: a fold of two would make the bank clearly smaller."""

Folds = list[NDArray[np.int64]]


def divide_presses(
    specimens: Sequence[str | None],
    count: int,
    rng: np.random.Generator,
    fewest: int = MIN_PRESSES,
    film: Sequence[int] = (),
) -> tuple[Folds, list[str]]:
    """Divide presses into folds, and warn where no piece can be held out: then they show nothing of other pieces.

    film: frames of one film in their order; empty for presses.

    Each fold leaves one press less than `fewest` at least, of as many presses or more. Two pieces are held out in
    turn: were presses held out one by one, with others of their piece learnt, most sound presses of a third piece
    could fail. A bank of one piece makes the limit rather high than low.
    """
    n, pieces = len(specimens), len(set(pieces_of(specimens)))
    count = n if n < LEAVE_ONE_OUT_BELOW else count
    piece_folds = folds(specimens, count, rng)
    if pieces > 1 and n - max(len(held) for held in piece_folds) >= fewest - 1:
        return piece_folds, []
    of = (
        "1 piece"
        if pieces == 1
        else f"{pieces} pieces, and without those of one fewer than {fewest - 1} are left"
    )
    warning = (
        f"{UNPROVEN}the {n} presses are of {of}: the limit is for presses of {'this' if pieces == 1 else 'these'} "
        f"alone, and sound presses of any other may fail; press more pieces, {fewest - 1} times each at least"
    )
    if film:
        return [np.sort(stretch) for stretch in np.array_split(film, _STRETCHES)], [warning]
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
