"""When presses are enough: the promise is reached, and more presses show little that is new.

The two signals are separate. The promise counts presses and pieces and knows nothing of what they show; the coverage
looks at what they show and promises nothing.
"""

import math
from dataclasses import dataclass

from calibration.acquisition.coverage import Coverage
from calibration.acquisition.forecast import PAYS, ROUND, fall, pays_until
from edge.core.binomial import CONFIDENCE, trials_needed, upper_rate

__all__ = ["EARLIEST", "Goal", "Standing"]

EARLIEST = 8
"""No coverage is trusted before this many presses: the curve's second half has five points then."""


@dataclass(frozen=True)
class Goal:
    """What is wanted: at most this rate of false alarms by press, with this confidence."""

    rate: float = 0.1
    confidence: float = CONFIDENCE

    @property
    def presses(self) -> int:
        """How many presses without an alarm promise it."""
        return trials_needed(self.rate, 0, self.confidence)


@dataclass(frozen=True)
class Standing:
    """Where an acquisition is. pieces: None where it is not known which press is of which piece."""

    presses: int
    pieces: int | None
    coverage: Coverage | None
    goal: Goal = Goal()

    def rate(self, trials: int) -> float:
        """The false alarms that this number of presses, or pieces, without an alarm still allow."""
        return upper_rate(0, trials, self.goal.confidence)

    @property
    def is_promised(self) -> bool:
        return self.presses >= self.goal.presses

    @property
    def fall(self) -> float | None:
        """By how much the next round is expected to lower the unseen share; None before EARLIEST presses."""
        if self.coverage is None or self.presses < EARLIEST:
            return None
        return fall(self.coverage.curve, ROUND / self.coverage.presses_of_each)

    @property
    def is_covered(self) -> bool:
        """Whether more presses have stopped paying."""
        return self.fall is not None and self.fall <= PAYS

    @property
    def is_enough(self) -> bool:
        return self.is_promised and self.is_covered

    @property
    def covered_at(self) -> int | None:
        """The forecast of the presses in all from which on more do not pay; None where the coverage is unknown."""
        if self.coverage is None:
            return None
        if self.is_covered:
            return self.presses
        each = self.coverage.presses_of_each
        pieces = pays_until(self.coverage.curve, ROUND / each)
        return max(math.ceil(pieces * each), EARLIEST)

    @property
    def still_needed(self) -> int | None:
        """The forecast of presses still needed, for the promise and the coverage; None while it is unknown."""
        if self.covered_at is None:
            return None
        return max(self.goal.presses, self.covered_at, self.presses) - self.presses
