"""What is measured of a reference press, and the words for what it says: they are in the press and in its message."""

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Imprint", "Outcome", "Signal"]


@dataclass(frozen=True)
class Imprint:
    """One press in numbers; None for what is not known of it.

    x_mm, y_mm: the centre of the contact, from the picture's left and top.
    """

    strength_levels: float | None = None
    """The colour difference to the free gel over the whole view; it grows with depth."""
    x_mm: float | None = None
    y_mm: float | None = None
    turn_deg: float | None = None
    """The turn of the part, where it is registered."""
    noise_levels: float | None = None
    """The temporal noise of the free gel just before, of one pixel of the small view."""


class Signal(StrEnum):
    """What the newest value says. The words are part of the published payload."""

    BEYOND_LIMIT = "beyond_limit"
    TWO_OF_THREE = "two_of_three"
    RUN_OF_EIGHT = "run_of_eight"


class Outcome(StrEnum):
    """What a reference press says of the station. The words are part of the published payload.

    learning: the limits are not known yet, and nothing else is wrong. warning: a run rule. not_measured: it was
    rejected or could not be scored, and says nothing.
    """

    LEARNING = "learning"
    IN_LIMITS = "in_limits"
    WARNING = "warning"
    OUT_OF_LIMITS = "out_of_limits"
    NOT_MEASURED = "not_measured"
