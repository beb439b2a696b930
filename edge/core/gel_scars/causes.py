"""Gel or part: the cause of one connected place above the limit.

The rules, in order; the numbers are chosen on simulated gels, see docs/gel.md.
"""

from typing import Final

from edge.core.arrays import F32
from edge.core.gel_scars.record import Repeats
from edge.core.sentence import Sentence
from edge.core.verdict import Blame, Cause

__all__ = ["SEVERAL", "blame", "doubt", "is_explained", "remaining", "together"]

# Of how far a place is above the limit, this share at most is left where a mark of the gel causes it, and more than the
# second one where the part does, when the press is scored without the marks.
_OF_THE_GEL, _OF_THE_PART = 0.2, 0.5

SEVERAL: Final = 2.7
"""Three presses of late: the place of the gel, not of the part, when other places of the part lay there."""
# At least in this share of the presses that showed the place.
_MOSTLY = 0.5
# The place of the part that lies there varies by more than this between those presses, and by more than the place is
# wide: damage moves with the part, and would not come back to this place of the gel.
_MOVED_MM = 1.0
# Five presses of late at one place of gel and part: only the free gel can distinguish them.
_MANY, _ALWAYS = 4.6, 0.8


def remaining(excess: F32, without_marks: F32) -> float:
    """The share of a place that is left without the marks of the gel, 0 to 1.

    excess: how far each pixel of the place is above the limit, float32 (h, w), 0 elsewhere. without_marks: the same of
    the press without the marks, at every place.
    """
    total = float(excess.sum())
    return min(1.0, float(without_marks[excess > 0].sum()) / total) if total > 0 else 1.0


def is_explained(left: float | None) -> bool:
    """Tell whether the marks alone give the place. left: of `remaining`."""
    return left is not None and left <= _OF_THE_GEL


def doubt(left: float, at_least: float) -> float:
    """Return the share that counts as left without the marks where some of these may be the rest of the last press.

    left: without the marks that are none. at_least: without all. What these alone explain is unsure.
    """
    return min(left, max(at_least, _OF_THE_PART))


def blame(left: float | None, repeats: Repeats, wide_mm: float) -> Blame:
    """The cause of one place. left: of `remaining`, None where the free gel is not known. wide_mm: its width."""
    if is_explained(left):
        why = Sentence(
            "without the marks that the free gel shows it is not there; wipe the gel, and if it stays, "
            "replace it"
        )
        return Blame(Cause.GEL, why)
    if left is not None and left <= _OF_THE_PART:
        why = Sentence("the free gel shows a mark there that explains only a part of it; press it elsewhere")
        return Blame(Cause.UNSURE, why)
    is_repeated = repeats.hits >= SEVERAL and repeats.rate >= _MOSTLY
    if is_repeated and repeats.spread_mm >= max(_MOVED_MM, wide_mm):
        why = Sentence(
            "the same place of the gel exceeded the limit in the presses before, while the part lay at different "
            "places; wipe the gel, and if it stays, replace it"
        )
        return Blame(Cause.GEL, why)
    if left is None:
        why = Sentence(
            "the free gel was not seen since the last press, so a mark on it cannot be excluded; lift for a second "
            "between presses"
        )
        return Blame(Cause.UNSURE, why)
    if repeats.hits >= _MANY and repeats.rate >= _ALWAYS:
        why = Sentence(
            "the same place exceeded the limit in press after press with the part at one place, though no mark "
            "of the free gel explains it; press a part that is known to be good, or press elsewhere"
        )
        return Blame(Cause.UNSURE, why)
    return Blame(Cause.PART, Sentence("no mark of the free gel explains it"))


def together(blames: list[Blame]) -> Blame | None:
    """Choose the blame of a press: damage counts before doubt, and doubt before the gel; None without any place."""
    for cause in (Cause.PART, Cause.UNSURE, Cause.GEL):
        if of_cause := [one for one in blames if one.cause is cause]:
            return of_cause[0]
    return None
