"""Which of several methods is better, by rows: paired differences over parts and draws, and when they do not decide.

Methods are compared on the same parts and seeds. The 95 % interval of a mean is that of `intervals`: over the means of
the parts, or over the draws of presses where there is one part, which says nothing about others. Seeds that learn the
same presses are one draw. A method is the best if the interval of its advantage over each other method is above zero.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calibration.experiments.harness.intervals import MIN_DRAWS, mean_interval

__all__ = ["Mean", "Sample", "Samples", "Standing", "Values", "ranking", "summarised"]

Values = Mapping[tuple[str, int], float]
"""(part, seed) to a measure of one method."""


@dataclass(frozen=True)
class Sample:
    """A measure of one method."""

    values: Values
    same: frozenset[str] = field(default_factory=frozenset)
    """The parts on which every seed learns the same presses."""

    def minus(self, other: "Sample") -> "Sample":
        """The differences on the parts and seeds that both have; a draw of either is a draw of the difference."""
        both = {pair: self.values[pair] - other.values[pair] for pair in self.values if pair in other.values}
        return Sample(both, self.same & other.same)


Samples = Mapping[str, Sample]
"""Method to its sample."""


@dataclass(frozen=True)
class Mean:
    """A mean and its 95 % interval, nan where there is none."""

    value: float
    low: float
    high: float
    parts: int
    draws: int
    """The least number of draws on a part."""

    @property
    def has_interval(self) -> bool:
        return math.isfinite(self.low)


@dataclass(frozen=True)
class Standing:
    """Methods in order of their mean, the best first."""

    means: Mapping[str, Mean]
    best: str | None
    """The method that is better than all others, None if the values do not decide; then `why` says why not."""
    rivals: tuple[str, ...]
    """Methods that cannot be distinguished from the first."""
    why: str


def summarised(sample: Sample, span: tuple[float, float] = (-math.inf, math.inf)) -> Mean:
    """The mean over parts of the means over seeds, with its interval. span: the lowest and highest value possible."""
    groups = {
        part: np.array([value for (name, _), value in sorted(sample.values.items()) if name == part])
        for part in sorted({part for part, _ in sample.values})
    }
    centres = np.array([group.mean() for group in groups.values()])
    draws = min(1 if part in sample.same else len(group) for part, group in groups.items())
    few = next(iter(groups.values()))[:draws] if len(groups) == 1 else centres
    low, high = mean_interval(few, *span)
    return Mean(float(centres.mean()), low, high, len(groups), draws)


def ranking(
    samples: Samples, *, higher_is_better: bool = True, span: tuple[float, float] = (-math.inf, math.inf)
) -> Standing:
    """The standing of methods. span: of the measure. Errors: ValueError without a method."""
    sign = 1 if higher_is_better else -1
    width = span[1] - span[0]
    means = {method: summarised(sample, span) for method, sample in samples.items()}
    order = sorted(means, key=lambda method: -sign * means[method].value)
    first, means = order[0], {method: means[method] for method in order}
    if len(order) == 1:
        return Standing(
            means, None, (), f"the rows have {first} alone, so there is nothing to compare it with"
        )
    rivals, spans = [], []
    for other in order[1:]:
        difference = samples[first].minus(samples[other])
        if not difference.values:
            return Standing(means, None, (other,), f"{first} and {other} have no part and seed in common")
        advantage = summarised(difference, (-width, width))
        if not advantage.has_interval:
            return Standing(means, None, tuple(order[1:]), _too_few(difference, advantage))
        low, high = sorted((sign * advantage.low, sign * advantage.high))
        if low <= 0:
            rivals.append(other)
            spans.append(f"{low:+.3f} to {high:+.3f} over {other}")
    if rivals:
        return Standing(means, None, tuple(rivals), f"the advantage of {first} is {'; '.join(spans)}")
    return Standing(means, first, (), "")


def _too_few(difference: Sample, advantage: Mean) -> str:
    if advantage.parts > 1:
        return f"with {advantage.parts} parts there is no interval, at least {MIN_DRAWS} are needed"
    if difference.same:
        return (
            "all seeds of this part learn the same presses, so nothing shows what other presses would give; more parts "
            "or fewer presses of the pool would"
        )
    draws = advantage.draws
    return f"with {draws} seed{'s' * (draws > 1)} there is no interval, at least {MIN_DRAWS} are needed"
