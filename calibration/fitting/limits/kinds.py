"""The kinds of limit, in the order in which they are preferred where they find equally much."""

from dataclasses import dataclass

__all__ = ["KINDS", "PLAIN", "LimitKind"]


@dataclass(frozen=True)
class LimitKind:
    """How a score map is compared.

    window_mm: the standard deviation of the Gaussian window whose mean is subtracted from each value, None to subtract
    nothing. is_by_place: whether each place has its own limit, from the median and the spread of the nominal presses
    there. about: what the map is compared with, in words.
    """

    name: str
    about: str
    window_mm: float | None = None
    is_by_place: bool = False


PLAIN = LimitKind("plain", "one limit for all places")

# Windows are chosen on the development set of real touch: at 0.5 mm most of a smooth difference between two presses is
# gone and an edit of 1 mm is not; the wide one keeps more of wide damage.
KINDS = (
    PLAIN,
    LimitKind("places", "the range of nominal presses at the same place", is_by_place=True),
    LimitKind("surroundings", "its surroundings (0.5 mm)", 0.5),
    LimitKind("wide surroundings", "its surroundings (1.25 mm)", 1.25),
    LimitKind("surroundings by place", "its surroundings (0.5 mm), by place", 0.5, True),
    LimitKind("wide surroundings by place", "its surroundings (1.25 mm), by place", 1.25, True),
)
"""Every kind, the plain limit first."""
