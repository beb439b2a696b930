"""The gel's life: its presses, its limit, and what to do about it."""

from enum import StrEnum

__all__ = ["DEFAULT_LIMIT_PRESSES", "DEFAULT_WARN_FRACTION", "MOST_PRESSES", "GelState", "state_of"]

# The maker's figure for the GelSight Mini gel: 1,000 coin presses (datasheet). Sharp threads cut faster than coins;
# the seed paper used up two gels over 2,678 listed pictures, about 1,340 each.
DEFAULT_LIMIT_PRESSES = 1000
# A larger number is a typing error: no gel lasts as long.
MOST_PRESSES = 10_000_000
# Time to order and fit a new one.
DEFAULT_WARN_FRACTION = 0.8


class GelState(StrEnum):
    """What to do about the gel. The values are part of the published payload."""

    GOOD = "good"
    DUE = "due"
    REPLACE = "replace"


def state_of(
    presses: int, limit: int = DEFAULT_LIMIT_PRESSES, warn_fraction: float = DEFAULT_WARN_FRACTION
) -> GelState:
    """Compare a gel's presses with its limit: due from the warning fraction on, replace from the limit on."""
    if presses < 0 or limit < 1:
        raise ValueError(f"presses >= 0 and limit >= 1 are needed, found {presses} and {limit}")
    if not 0 < warn_fraction <= 1:
        raise ValueError(f"the warning fraction is in (0, 1], found {warn_fraction}")
    if presses >= limit:
        return GelState.REPLACE
    return GelState.DUE if presses >= warn_fraction * limit else GelState.GOOD
