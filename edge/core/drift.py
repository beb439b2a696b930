"""Drift of ordinary production: a chart that finds when a value has shifted, without presses that are set apart for it.

A self-starting CUSUM: each value is compared with all that came before it, which makes independent standard normal
values of independent normal ones, whatever their mean and deviation. Two sums collect how far they lie above and below.

Ref: Hawkins, Journal of Quality Technology 19 (1987): the self-starting CUSUM. Wallace, Annals of Mathematical
Statistics 30 (1959): the normal value of a value of Student's distribution, here to 0.02. Siegmund, Sequential
Analysis (1985): a two-sided chart with K = 0.5 and H = 10 has one false alarm in 70,000 values. Measured after 100
values: a shift by one standard deviation is found after 24 values in the median, by two after 8.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Final, Self

from edge.core.reference_press.outcome import Measure
from edge.core.sentence import Sentence

__all__ = ["LEARNT", "MEASURES", "DriftChart"]

# Half of the shift in standard deviations that is found soonest.
K: Final = 0.5
# The sum from which a shift is said.
H: Final = 10.0
# One value counts for no more: presses have rare large values, which are no shift.
MOST_SIGMAS: Final = 3.0

LEARNT: Final = 20
"""Values before a shift can be said."""


MEASURES: Final = (
    Measure(
        "score_ratio",
        "score / threshold",
        "",
        "bundle",
        0.02,
        0.05,
        "wipe the gel and look at the newest pictures; if the parts have changed, fit again with some of them",
    ),
    Measure(
        "strength_levels", "strength", "levels", "bundle", 0.01, 0.02, "check the force, the stop and the gel"
    ),
    Measure("x_mm", "place x", "mm", "bundle", 0.05, 0.0, "check the fixture and the sensor's mount"),
    Measure("y_mm", "place y", "mm", "bundle", 0.05, 0.0, "check the fixture and the sensor's mount"),
    Measure("noise_levels", "noise", "levels", "bundle", 0.05, 0.1, "check light, exposure and cable"),
    Measure(
        "light_levels",
        "light of the free gel",
        "levels",
        "bundle",
        0.5,
        0.02,
        "check the lamp; clean the gel's edge",
    ),
)
"""In the order in which they are said."""


@dataclass(frozen=True)
class DriftChart:
    """One measure over the passing presses of one bundle on one gel; eight numbers, which are kept."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0
    """The sum of the squared distances to the mean."""
    above: float = 0.0
    """The sum of what lies above, in standard deviations."""
    below: float = 0.0
    since_above: int = 0
    """Values since `above` was 0."""
    since_below: int = 0
    newest: float = 0.0
    """The mean of the newest values, about twenty."""

    @classmethod
    def from_numbers(cls, numbers: list[float]) -> Self:
        """Make it of what `numbers` gave. Errors: ValueError."""
        if len(numbers) != len(fields(cls)) or not all(map(math.isfinite, numbers)):
            raise ValueError(f"a chart has {len(fields(cls))} finite numbers, found {numbers}")
        count, mean, squares, above, below, since_above, since_below, newest = numbers
        return cls(round(count), mean, squares, above, below, round(since_above), round(since_below), newest)

    @property
    def numbers(self) -> list[float]:
        """Give all of it as numbers."""
        return [float(getattr(self, field.name)) for field in fields(self)]

    @property
    def shift(self) -> int:
        """Tell whether the values lie higher (1) or lower (-1) than before; 0 where no shift is shown. It does not end:
        begin another chart."""
        if self.count < LEARNT or max(self.above, self.below) <= H:
            return 0
        return 1 if self.above >= self.below else -1

    @property
    def since(self) -> int:
        """Give the number of values since the shift began, about."""
        return self.since_above if self.above >= self.below else self.since_below

    def add(self, value: float, measure: Measure) -> "DriftChart":
        """Return the chart with one more value. Errors: ValueError for a value that is not finite."""
        if not math.isfinite(value):
            raise ValueError(f"a chart takes finite values, found {value}")
        far = self._standardise(value, measure)
        count, step = self.count + 1, value - self.mean
        mean = self.mean + step / count
        above, below = self.above, self.below
        if not self.shift:  # it stays one when its own values are most of the mean
            above, below = max(0.0, above + far - K), max(0.0, below - far - K)
        return replace(
            self,
            count=count,
            mean=mean,
            squares=self.squares + step * (value - mean),
            above=above,
            below=below,
            since_above=self.since_above + 1 if above else 0,
            since_below=self.since_below + 1 if below else 0,
            newest=self.newest + (value - self.newest) / min(count, LEARNT),
        )

    def _standardise(self, value: float, measure: Measure) -> float:
        """Return how far it lies from all before it, as a standard normal value."""
        n = self.count
        if n < 2:
            return 0.0
        floor = max(measure.floor, measure.relative_floor * abs(self.mean))
        sigma = max(math.sqrt(self.squares / (n - 1)), floor)
        t, freedom = (value - self.mean) / sigma * math.sqrt(n / (n + 1)), n - 1
        z = math.sqrt(freedom * math.log1p(t * t / freedom)) * (8 * freedom + 1) / (8 * freedom + 3)
        return math.copysign(min(z, MOST_SIGMAS), t)

    def describe(self, measure: Measure) -> Sentence:
        """Say what has shifted, since when, and what to do."""
        unit = f" {measure.unit}" if measure.unit else ""
        way = Sentence("higher") if self.shift > 0 else Sentence("lower")
        return Sentence(
            f"{measure.title} is {way} since about {self.since} passing presses: {self.newest:.3g}{unit}, "
            f"and {self.mean:.3g} in the mean of {self.count}; {measure.what_to_do}"
        )
