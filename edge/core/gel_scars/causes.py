"""Gel or part: the cause of one connected place above the limit.

The rules, in order; the numbers are chosen on simulated gels, see docs/gel-scars.md.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.gel_scars.record import Repeats

__all__ = ["MOSTLY", "REACH_PX", "SEVERAL", "Blame", "Cause", "blame", "explained", "together", "within"]

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


class Cause(StrEnum):
    """Where what was found comes from. The words are part of the published payload."""

    PART = "part"
    GEL = "gel"
    UNSURE = "unsure"


@dataclass(frozen=True)
class Blame:
    """A cause, and a sentence why."""

    cause: Cause
    why: str


REACH_PX: Final = 2
"""A mark explains what a map shows within this distance: 2 pixels of the view, 0.25 mm on a GelSight Mini."""
# The next pixel: of a mask, what is left of a scar there.
_RIM_PX = 1.5
# A mark of less than this share of a place does not explain it: a speck somewhere in a large dent.
_LEAST_MARKED = 0.25

# Of a place, weighted by how far it is above the limit: from the first share on the marks explain it, from the second
# one if it came back, below the last one they do not.
_EXPLAINED, _HALF_EXPLAINED, _UNEXPLAINED = 0.8, 0.5, 0.3

SEVERAL: Final = 2.7
"""Three presses of late: the place of the gel, not of the part, when the part lay elsewhere each time."""
MOSTLY: Final = 0.5
"""At least in this share of the presses that showed the place."""
# The part's place varies by more than this between those presses, and by more than the place is wide: damage at one
# place of the part moves with it, and would not come back to this place of the gel.
_MOVED_MM = 1.0
# Five presses of late at one place of gel and part: only the free gel can distinguish them.
_MANY, _ALWAYS = 4.6, 0.8


def explained(excess: F32, marked: Mask, masked: Mask) -> float:
    """The share of a place that marks of the free gel explain, 0 to 1.

    excess: how far each pixel is above the limit, float32 (h, w), 0 elsewhere. marked, masked: bool (h, w).
    """
    total, place = float(excess.sum()), excess > 0
    near = within(masked, _RIM_PX)
    if (marked & within(place, _RIM_PX)).sum() >= _LEAST_MARKED * place.sum():
        near = near | within(marked, REACH_PX)
    return float(excess[near].sum()) / total if total > 0 else 0.0


def within(places: Mask, reach_px: float) -> Mask:
    """Pixels at most this far from one of the places, bool (h, w)."""
    if not places.any():
        return places
    away = cv2.distanceTransform((~places).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(away <= reach_px)


def blame(share: float | None, repeats: Repeats, wide_mm: float) -> Blame:
    """The cause of one place. share: of `explained`, None where the free gel is not known. wide_mm: its width."""
    has_come_back = repeats.hits >= SEVERAL
    if share is not None and share >= (_HALF_EXPLAINED if has_come_back else _EXPLAINED):
        return Blame(Cause.GEL, "the free gel shows a mark there; wipe the gel, and if it stays, replace it")
    if share is not None and share >= _UNEXPLAINED:
        return Blame(
            Cause.UNSURE,
            "the free gel shows a mark there that explains only a part of it; press it elsewhere",
        )
    is_repeated = has_come_back and repeats.rate >= MOSTLY
    if is_repeated and repeats.spread_mm >= max(_MOVED_MM, wide_mm):
        return Blame(
            Cause.GEL,
            "the same place of the gel exceeded the limit in the presses before, while the part lay at different "
            "places; wipe the gel, and if it stays, replace it",
        )
    if share is None:
        return Blame(
            Cause.UNSURE,
            "the free gel was not seen since the last press, so a mark on it cannot be excluded; lift for a second "
            "between presses",
        )
    if repeats.hits >= _MANY and repeats.rate >= _ALWAYS:
        return Blame(
            Cause.UNSURE,
            "the same place exceeded the limit in press after press with the part at one place, though the free gel "
            "shows no mark there; press a part that is known to be good, or press elsewhere",
        )
    return Blame(Cause.PART, "the free gel shows no mark there")


def together(blames: list[Blame]) -> Blame | None:
    """Of all places of a press: damage counts before doubt, and doubt before the gel. None where there is none."""
    for cause in (Cause.PART, Cause.UNSURE, Cause.GEL):
        found = next((one for one in blames if one.cause is cause), None)
        if found is not None:
            return found
    return None
