"""Checks that a bank covers its own nominal presses, and gives it more room where it does not.

A bank of limited size may by chance leave out a place that every press has, where the banks of the folds did not. Then
sound presses score higher with it than the threshold expects, and fail. The nominal presses show this: they must not
score higher with the final bank than with banks without them. Where a few do, their higher score counts for the
threshold.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.limits.held_out import HeldOut, Learner, ScoredPresses, ShownPresses
from edge.core.detector import Bank, Nominal
from edge.core.errors import FitError

__all__ = ["Covered", "covering_bank", "is_covered"]

ROOMS = (1.0, 1.5, 2.0, 4.0)
"""The factors of a bank's usual room, tried in turn until it covers its nominal presses."""

COVERED_RATIO = 1.1
"""How far nominal presses may score above their out-of-fold scores with the final bank, in the median."""

COVERED_SHARE = 0.25
"""The share of nominal presses that may fail with it: a missing place of every press makes most of them fail."""


@dataclass(frozen=True, eq=False)
class Covered:
    """A bank that covers its nominal presses."""

    bank: Bank
    room: float
    """How many times its usual size it may have."""
    held_out: HeldOut | None = None
    """What banks without them show of the presses; None where no threshold is wanted."""
    known: ScoredPresses | None = None
    """The nominal presses by the bank, which knows them; None where no threshold is wanted."""

    @property
    def scores(self) -> NDArray[np.float64] | None:
        """Scores of the nominal presses, (n,), for the threshold."""
        if self.held_out is None or self.known is None:
            return None
        return np.maximum(self.known.scores, self.held_out.sound.scores)


def covering_bank(
    learner: Learner,
    nominal: Nominal,
    learn: Callable[[Nominal], tuple[Bank, HeldOut | None]],
    find_threshold: Callable[[NDArray[np.float64]], float],
    shown: ShownPresses | None = None,
) -> Covered:
    """Learn a bank with the least room in which it covers the presses.

    learn: nominal presses and a room to a bank, and what banks without them show of the presses. find_threshold: from
    scores. shown: the nominal presses as the gateway shows them; None as they are learnt. Errors: FitError where more
    room does not help.
    """
    shown = shown or ShownPresses(nominal.features)
    size = 0
    for room in ROOMS:
        bank, held_out = learn(replace(nominal, room=room))
        if held_out is None:
            return Covered(bank, room)
        unknown = held_out.sound.scores
        known = learner.score_shown(bank, shown, np.arange(nominal.presses))
        if is_covered(known.scores, unknown, find_threshold(unknown)):
            return Covered(bank, room, held_out, known)
        if (grown := sum(array.nbytes for array in bank.arrays.values())) <= size:
            break
        size = grown
    raise FitError(
        f"the bank of {learner.detector.name} lacks what its own nominal presses show: they score higher by it than by "
        "banks that do not know them, and good parts would fail; fit another method, or look whether the presses are "
        "of one part at one position"
    )


def is_covered(known: NDArray[np.float64], held_out: NDArray[np.float64], threshold: float) -> bool:
    """Tell whether few nominal presses fail with the final bank, and in the median they do not score higher with it.

    known, held_out: their scores with the final bank and with banks without them, (n,) each. threshold: from the
    latter.
    """
    is_higher = np.median(known) > COVERED_RATIO * np.median(held_out)
    return bool(np.mean(known > threshold) <= COVERED_SHARE and not is_higher)
