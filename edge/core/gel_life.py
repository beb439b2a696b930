"""The gel's life: its presses, its limit, and what to do about it."""

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["DEFAULT_LIMIT_PRESSES", "DEFAULT_WARN_FRACTION", "MOST_PRESSES", "GelLife", "GelState"]

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


@dataclass(frozen=True)
class GelLife:
    """A gel's press count against its limit."""

    presses: int
    limit: int = DEFAULT_LIMIT_PRESSES
    warn_fraction: float = DEFAULT_WARN_FRACTION

    def __post_init__(self) -> None:
        if self.presses < 0 or self.limit < 1:
            raise ValueError(f"presses >= 0 and limit >= 1 are needed, found {self.presses} and {self.limit}")
        if not 0 < self.warn_fraction <= 1:
            raise ValueError(f"the warning fraction is in (0, 1], found {self.warn_fraction}")

    @property
    def state(self) -> GelState:
        """Due from the warning fraction on, replace from the limit on."""
        if self.presses >= self.limit:
            return GelState.REPLACE
        return GelState.DUE if self.presses >= self.warn_fraction * self.limit else GelState.GOOD
