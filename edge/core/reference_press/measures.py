"""What is measured of a reference press, and what each measure belongs to."""

from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["MEASURES", "Imprint", "Measure"]

Scope = Literal["bundle", "gel", "place"]


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


@dataclass(frozen=True)
class Measure:
    """One chart."""

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


MEASURES: Final[tuple[Measure, ...]] = (
    # 1 % of the master piece's own score: int8 and fp32 trunks, or two processors, differ by less.
    Measure("score", "score", "", "bundle", 1e-6, 0.01, "clean gel and master piece, look at its picture"),
    # The strength of one press held still changes by about 1 %.
    Measure(
        "strength_levels", "strength", "levels", "gel", 0.01, 0.01, "check the force, the stop and the gel"
    ),
    # A twentieth of a millimetre, about one pixel at 320x240: a finer place is not meant.
    Measure("x_mm", "place x", "mm", "place", 0.05, 0.0, "check fixture and sensor mount"),
    Measure("y_mm", "place y", "mm", "place", 0.05, 0.0, "check fixture and sensor mount"),
    # The registration's own standard deviation is a tenth of a degree on long parts.
    Measure("turn_deg", "turn", "deg", "place", 0.1, 0.0, "check fixture and sensor mount"),
    Measure("noise_levels", "noise", "levels", "gel", 0.05, 0.05, "check light, exposure and cable"),
)
"""In the order in which they are shown."""
