"""The control chart of individual values: limits from the moving range, and the run rules that are worth their alarms.

Ref: ASTM E2587 (control charts in SPC), individuals chart; AIAG, Statistical Process Control, 2nd edition, chapter II.
Limits are the mean +- 2.66 mean moving ranges, which is +- 3 sigma with sigma = mean moving range / 1.128.

The rules are those of the Western Electric handbook (1956). With limits that are known exactly, on independent normal
values, the average number of values between two false alarms is 370 with the first rule alone, 225 with the first and
the second, 153 with the first and the fourth, 122 with all three (Champ and Woodall, Technometrics 29, 1987, table 1).
The third rule (four of five beyond one sigma) and the rule of six rising values are left out: they find little that
the others do not, and with all four Western Electric rules an alarm comes every 92 values.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Final, Self

__all__ = ["RUN_LENGTH", "Limits", "Signal", "signals"]

# The mean range of two normal values in standard deviations: d2 of ASTM E2587, table 6.
D2: Final = 1.128
# Limits are this many standard deviations from the centre.
LIMIT_SIGMAS: Final = 3.0
# The second Western Electric rule: two of three values beyond two sigmas.
WARNING_SIGMAS: Final = 2.0
# The fourth one: this many values in a row on one side of the centre.
RUN_LENGTH: Final = 8


class Signal(StrEnum):
    """What the newest value says. The words are part of the published payload."""

    BEYOND_LIMIT = "beyond_limit"
    TWO_OF_THREE = "two_of_three"
    RUN_OF_EIGHT = "run_of_eight"


@dataclass(frozen=True)
class Limits:
    """The centre, and one standard deviation of a single value, both finite; sigma is above 0."""

    centre: float
    sigma: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.centre) and math.isfinite(self.sigma) and self.sigma > 0):
            raise ValueError(f"limits are finite and sigma is above 0, found {self.centre} and {self.sigma}")

    @classmethod
    def of(cls, values: Sequence[float], floor: float) -> Self:
        """Compute limits from values in the order in which they were taken, at least two.

        floor: sigma is not less than this, above 0: values that repeat exactly would make every later one an alarm.
        """
        if len(values) < 2:
            raise ValueError(f"limits need two values or more, found {len(values)}")
        ranges = [abs(later - earlier) for earlier, later in pairwise(values)]
        return cls(math.fsum(values) / len(values), max(math.fsum(ranges) / len(ranges) / D2, floor))

    @property
    def low(self) -> float:
        return self.centre - LIMIT_SIGMAS * self.sigma

    @property
    def high(self) -> float:
        return self.centre + LIMIT_SIGMAS * self.sigma

    def sigmas(self, value: float) -> float:
        """Measure how far a value is from the centre, signed."""
        return (value - self.centre) / self.sigma


def signals(values: Sequence[float], limits: Limits) -> tuple[Signal, ...]:
    """Find what the last of the values signals; empty for nothing. values: oldest first."""
    distances = [limits.sigmas(value) for value in values]
    if not distances:
        return ()
    side = math.copysign(1.0, distances[-1])
    last = [side * far for far in distances[-RUN_LENGTH:]]
    said = {
        Signal.BEYOND_LIMIT: last[-1] > LIMIT_SIGMAS,
        Signal.TWO_OF_THREE: last[-1] > WARNING_SIGMAS
        and sum(far > WARNING_SIGMAS for far in last[-3:]) >= 2,
        Signal.RUN_OF_EIGHT: len(last) == RUN_LENGTH and min(last) > 0,
    }
    return tuple(signal for signal, is_so in said.items() if is_so)
