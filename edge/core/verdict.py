"""The verdict on a press: pass, fail, unsure, or rejected with a reason; and the cause of what is not passed.

An error is not a verdict.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from edge.core.errors import NotScorable
from edge.core.imaging.quality import Rejection

__all__ = ["Blame", "Cause", "Kind", "Verdict", "decide"]


class Kind(StrEnum):
    """The result of a press. The words are part of the published payload."""

    PASS = "pass"
    FAIL = "fail"
    UNSURE = "unsure"
    REJECTED = "rejected"


@dataclass(frozen=True)
class Verdict:
    """A verdict with the numbers behind it. Scores are raw, higher is more anomalous.

    score, threshold and tolerance are None for a rejected press, which was not scored; rejection is None otherwise.
    """

    kind: Kind
    score: float | None = None
    threshold: float | None = None
    tolerance: float | None = None
    rejection: Rejection | None = None

    def __post_init__(self) -> None:
        numbers = (self.score, self.threshold, self.tolerance)
        is_rejected = self.kind is Kind.REJECTED
        if is_rejected != (self.rejection is not None) or is_rejected != all(n is None for n in numbers):
            raise ValueError(
                f"a rejected press has a rejection and no score, any other the reverse, found {self}"
            )
        if not is_rejected and not all(n is not None and math.isfinite(n) for n in numbers):
            raise ValueError(f"a verdict's numbers are finite, found {numbers}")

    @classmethod
    def rejected(cls, rejection: Rejection) -> Self:
        """The verdict on a press that cannot be judged."""
        return cls(Kind.REJECTED, rejection=rejection)


def decide(score: float, threshold: float, tolerance: float = 0.0) -> Verdict:
    """Pass, fail, or unsure where the score is within `tolerance` of the threshold, including the edges.

    A score at the threshold passes when there is no tolerance: the threshold is the largest score that nominal presses
    are allowed. Errors: NotScorable for a score or threshold that is not finite; ValueError for a tolerance that is
    negative or not finite.
    """
    if not (math.isfinite(score) and math.isfinite(threshold)):
        raise NotScorable(
            f"the score is {score} against the threshold {threshold}; both must be finite, so this press has no verdict"
        )
    if not (math.isfinite(tolerance) and tolerance >= 0):
        raise ValueError(f"a tolerance is finite and not negative, found {tolerance}")
    kind = Kind.FAIL if score > threshold else Kind.PASS
    if tolerance > 0 and threshold - tolerance <= score <= threshold + tolerance:
        kind = Kind.UNSURE
    return Verdict(kind, float(score), float(threshold), float(tolerance))


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
