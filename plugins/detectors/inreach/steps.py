"""The steps of InReaCh in which the published code differs by a defect; `paper.py` has the published ones."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["CORRECTED", "EQUAL", "Joined", "Match", "Nearest", "Steps", "squared_distances"]

# Two distances that differ by less than this part are equal: rounding of float32.
EQUAL = 1e-5
# A squared distance below this part of the two squared lengths is rounding of the product, in float32.
ROUNDING = 1e-6


class Match(NamedTuple):
    """For each patch of a press, its nearest patch of a realisation."""

    squared: NDArray[np.float32]
    """The squared distance, float32 (cells,)."""
    patch: NDArray[np.int64]
    """The nearest patch, int64 (cells,)."""
    is_mutual: NDArray[np.bool_]
    """Whether that patch's nearest is this one."""


class Nearest(NamedTuple):
    """Both directions between a press and each of k realisations, by the product."""

    there: NDArray[np.int64]
    """Int64 (k, cells), for each patch of the press the nearest of the realisation."""
    away: NDArray[np.float32]
    """Float32 (k, cells), its squared distance."""
    back: NDArray[np.float32]
    """Float32 (k, cells), for each patch of the realisation the distance to the nearest patch of the press."""
    lengths: NDArray[np.float32]
    """Float32 (k, cells), the sum of the squared lengths of both patches at each place."""


class Joined(NamedTuple):
    """A press and one realisation, with exact distances."""

    squared: NDArray[np.float32]
    """Squared distances, float32 (cells,)."""
    there: NDArray[np.int64]
    """Int64 (cells,), for each patch of the press its nearest of the realisation."""
    back: NDArray[np.int64]
    """The other direction, -1 for none."""


@dataclass(frozen=True)
class Steps:
    """The steps in which a publication differs by a defect."""

    prefer: Callable[[NDArray[np.float32], NDArray[np.float32], Nearest, Joined], Joined]
    """Which of equally near patches is the nearest."""
    is_taken: Callable[[Match, NDArray[np.float32]], NDArray[np.bool_]]
    """Which patches join this realisation instead of the best so far."""
    member: Callable[[NDArray[np.int64], NDArray[np.int64], int], tuple[NDArray[np.int64], NDArray[np.int64]]]
    """Opener and matched patch to the channel's key and its member."""
    is_near: Callable[[NDArray[np.float64], NDArray[np.float64], float], NDArray[np.bool_]]
    """Which members stay, by their distance from the mean, the channel's limit and the stray distance."""
    is_tight: Callable[[NDArray[np.float64], float], NDArray[np.bool_]]
    """Which channels stay, by their root mean square distance and the stray distance."""
    has_fallback: bool
    """Whether every patch is the bank where no channel remains."""


def squared_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Squared distances (p,) of rows (p, c), as sums of squared differences."""
    difference = a - b
    squares: NDArray[np.float32] = np.einsum("pc,pc->p", difference, difference)
    return squares


def prefer_own_place(
    asked: NDArray[np.float32], seed: NDArray[np.float32], nearest: Nearest, found: Joined
) -> Joined:
    """Among equally near patches the one at the same place wins, so that constant gel keeps its channels."""
    every, here = np.arange(len(asked)), squared_distances(asked, seed)
    is_there = here <= found.squared * (1 + EQUAL)
    is_back = here <= np.maximum(nearest.back, 0) * (1 + EQUAL) + ROUNDING * nearest.lengths
    return Joined(
        np.where(is_there, here, found.squared),
        np.where(is_there, every, found.there),
        np.where(is_back, every, found.back),
    )


def is_closest_mutual(found: Match, best: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Closer than the best so far, and mutual; otherwise the patch may still join another realisation."""
    return (found.squared < best) & found.is_mutual


def as_matched(
    opener: NDArray[np.int64], patch: NDArray[np.int64], cells: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The opener is the channel's key, the patch its member."""
    return opener, patch


def is_near(away: NDArray[np.float64], limit: NDArray[np.float64], stray: float) -> NDArray[np.bool_]:
    """Within the limit, or as near as most members of all channels."""
    return away <= np.maximum(limit, stray)


def is_tight(spread: NDArray[np.float64], stray: float) -> NDArray[np.bool_]:
    """Not wider than the stray distance."""
    return spread <= stray * (1 + EQUAL)


CORRECTED = Steps(prefer_own_place, is_closest_mutual, as_matched, is_near, is_tight, has_fallback=True)
