"""The control chart of individual values: what is measured, limits from the moving range, and the run rules.

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
from itertools import pairwise
from typing import Final, Self

from edge.core.reference_press.outcome import Measure, Signal

__all__ = ["MEASURES", "Limits", "signals"]

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


# The mean range of two normal values in standard deviations: d2 of ASTM E2587, table 6.
D2: Final = 1.128
# Limits are this many standard deviations from the centre.
LIMIT_SIGMAS: Final = 3.0
# The second Western Electric rule: two of three values beyond two sigmas.
WARNING_SIGMAS: Final = 2.0
# The fourth one: this many values in a row on one side of the centre.
RUN_LENGTH: Final = 8


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
