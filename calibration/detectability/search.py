"""One trial: the smallest size of damage, at one spot of one press, that the bundle's verdict finds."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.rendered_damage.damage import KINDS, Damage, Spot
from calibration.rendered_damage.footprint import surroundings
from calibration.rendered_damage.imprint import Station
from edge.core.errors import PoseNotFound
from edge.core.verdict import Kind as Result
from edge.model.manifest import Manifest
from edge.model.scorer import Scored, Scorer

__all__ = ["Judge", "Press", "sizes_mm", "smallest_found"]

# The smallest size tried, as a share of the largest, and the number of sizes: each is 1.13 times the one before.
_SMALLEST_SHARE, _SIZES = 1 / 50, 33


def sizes_mm(kind: str) -> tuple[float, ...]:
    """The sizes that are tried, rising by equal factors."""
    largest = KINDS[kind].largest_mm
    return tuple(round(float(a), 5) for a in np.geomspace(_SMALLEST_SHARE * largest, largest, _SIZES))


def smallest_found(is_found: Callable[[float], bool], sizes: Sequence[float]) -> tuple[float, float]:
    """The smallest size that is found, as (largest missed, smallest found], by halving.

    (0, a] where the first is found already, (a, inf) where the last is missed. Larger damage is taken to be found if
    smaller damage is: sizes between are not tried.
    """
    if not is_found(sizes[-1]):
        return sizes[-1], math.inf
    missed, found = -1, len(sizes) - 1
    while found - missed > 1:
        middle = (missed + found) // 2
        missed, found = (missed, middle) if is_found(sizes[middle]) else (middle, found)
    return (0.0 if missed < 0 else sizes[missed]), sizes[found]


class Press(Protocol):
    """One press that can be shown with damage, uint8 (h, w, 3) of the station's region."""

    @property
    def station(self) -> Station: ...

    def damaged(self, damage: Damage) -> NDArray[np.uint8]: ...


@dataclass(frozen=True, eq=False)
class Judge:
    """The verdict on one press by a bank that has not learnt it. manifest: with the limit and its tolerance."""

    scorer: Scorer
    manifest: Manifest

    def passes(self, rgb: NDArray[np.uint8]) -> bool:
        """Whether the press passes as it is. Errors: NotScorable."""
        return self._result(self.scorer.score(rgb)) is Result.PASS

    def finds(self, press: Press, damage: Damage) -> bool:
        """Whether the press with the damage fails and its map is highest on the damage. Errors: NotScorable.

        A press whose part is not recognised any more is rejected, which finds no damage.
        """
        try:
            scored = self.scorer.score(press.damaged(damage))
        except PoseNotFound:
            return False
        if self._result(scored) is not Result.FAIL:
            return False
        row, column = np.unravel_index(int(scored.score_map.argmax()), scored.score_map.shape)
        return bool(surroundings(damage, press.station.field)[row, column])

    def bracket(self, press: Press, kind: str, spot: Spot) -> tuple[float, float]:
        """The smallest size found at that spot, (missed, found] in mm. Errors: NotScorable."""
        return smallest_found(lambda size: self.finds(press, Damage(kind, size, spot)), sizes_mm(kind))

    def _result(self, scored: Scored) -> Result:
        return self.manifest.decide(scored.anomaly_score).kind
