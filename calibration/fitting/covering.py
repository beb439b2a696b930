"""A bank that knows what its own nominal presses look like: checked, and given more room where it does not.

A bank of limited size may leave out a place that every press has, by bad luck where the banks of the folds did not:
then sound presses score higher by it than the threshold expects, and fail. It shows in the nominal presses
themselves, which must not score higher by the bank that knows them than by banks that do not.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.held_out import Learner
from calibration.fitting.threshold import conformal_threshold
from edge.core.detector import Bank, Nominal
from edge.core.errors import FitError
from edge.model.manifest import ThresholdEntry

__all__ = ["covering_bank", "covers", "is_covered"]

ROOMS = (1.0, 1.5, 2.0, 4.0)
"""How much of its usual room a bank gets, in turn, until it covers its nominal presses."""

COVERED_RATIO = 1.1
"""How far nominal presses may score above their out-of-fold scores by the bank that knows them, in the median."""

SAME_SCORE = 1e-3
"""Scores that differ by less than this part of the largest are one."""

Learnt = tuple[Bank, NDArray[np.float64] | None]


def covering_bank(
    name: str,
    nominal: Nominal,
    learnt: Callable[[Nominal], Learnt],
    is_covering: Callable[[Bank, NDArray[np.float64]], bool],
) -> tuple[Bank, NDArray[np.float64] | None, float]:
    """A bank, the out-of-fold scores that belong to it (None where none are wanted), and the room that it took.

    name: of the detector. learnt: the bank and the scores for nominal presses and a room.
    Errors: FitError where more room does not help.
    """
    size = 0
    for room in ROOMS:
        bank, held_out = learnt(replace(nominal, room=room))
        if held_out is None or is_covering(bank, held_out):
            return bank, held_out, room
        if (grown := sum(array.nbytes for array in bank.arrays.values())) <= size:
            break
        size = grown
    raise FitError(
        f"the bank of {name} lacks what its own nominal presses show: they score higher by it than by banks that do "
        "not know them, and good parts would fail; fit another method, or look whether the presses are of one part at "
        "one position"
    )


def covers(
    learner: Learner,
    bank: Bank,
    nominal: Nominal,
    held_out: NDArray[np.float64],
    alpha: float,
    specimens: Sequence[str | None],
) -> bool:
    """Whether a bank covers the presses that it was learnt from. Errors: FitError."""
    known = learner.scores(bank, nominal.features, range(nominal.presses))
    return is_covered(known, held_out, conformal_threshold(held_out, alpha, specimens=specimens))


def is_covered(known: NDArray[np.float64], held_out: NDArray[np.float64], limit: ThresholdEntry) -> bool:
    """Whether no more nominal presses fail than the threshold promises, and they do not as a rule score higher known.

    known, held_out: their scores by the final bank and by banks that did not know them, (n,) each.
    """
    same = SAME_SCORE * float(np.abs(held_out).max())
    fails = np.mean(known > limit.value + same)
    is_higher = np.median(known - COVERED_RATIO * held_out) > same
    return bool(fails <= max(limit.alpha, limit.alpha_floor) and not is_higher)
