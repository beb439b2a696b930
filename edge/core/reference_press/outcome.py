"""What is measured of a press, and the words for what a reference press says, as in the press and its message."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Self

from edge.core.contact.events import PressSettled
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["Imprint", "Measure", "Outcome", "Signal"]


Scope = Literal["bundle", "gel", "place"]


@dataclass(frozen=True)
class Measure:
    """What one chart is of."""

    name: str
    title: str
    unit: str
    scope: Scope
    """The chart begins again with another bundle, another gel, or neither: a place depends on the fixture."""
    floor: float
    """The least sigma, so that exact repetition makes no false alarm."""
    relative_floor: float
    """The least sigma as a share of the centre."""
    what_to_do: str
    """The end of a sentence for the person at the station."""


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

    @classmethod
    def of(cls, settled: PressSettled, profile: SensorProfile, turn_rad: float | None = None) -> Self:
        """Measure a press that has settled. turn_rad: of the part, where it is registered."""
        (x_mm, y_mm), (width, height) = profile.mm_per_pixel, profile.size
        return cls(
            strength_levels=settled.strength,
            x_mm=settled.touch.x * width * x_mm,
            y_mm=settled.touch.y * height * y_mm,
            turn_deg=None if turn_rad is None else math.degrees(turn_rad),
            noise_levels=None if settled.findings is None else settled.findings.noise_levels,
        )


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
