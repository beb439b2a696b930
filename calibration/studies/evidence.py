"""Which of several methods is better, by rows: paired differences over parts and seeds, and when they do not decide.

Methods are compared on the same parts and seeds. The 95 % interval of a mean is a percentile bootstrap that resamples
parts, and within each part seeds; with one part it says nothing about others. A method is the best if the interval of
its advantage over each other method is above zero.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["MIN_SEEDS", "Mean", "Samples", "Standing", "Values", "ranking", "summarised"]

MIN_SEEDS = 3
"""With fewer there is no interval."""

REPLICATES = 2000

Values = Mapping[tuple[str, int], float]
"""(part, seed) to a measure of one method."""

Samples = Mapping[str, Values]
"""Method to its values."""


@dataclass(frozen=True)
class Mean:
    """A mean and its 95 % interval, with the parts and the least number of seeds behind it."""

    value: float
    low: float
    high: float
    parts: int
    seeds: int


@dataclass(frozen=True)
class Standing:
    """Methods in order of their mean, the best first.

    best: the method that is better than all others, None if the values do not decide; then `why` says why not. rivals:
    those that cannot be distinguished from the first.
    """

    means: Mapping[str, Mean]
    best: str | None
    rivals: tuple[str, ...]
    why: str


def summarised(values: Values) -> Mean:
    """The mean over parts of the means over seeds, with its interval."""
    groups = _groups(values)
    drawn = _resampled(groups)
    low, high = np.quantile(drawn, [0.025, 0.975])
    centre = float(np.mean([group.mean() for group in groups]))
    return Mean(centre, float(low), float(high), len(groups), min(map(len, groups)))


def ranking(samples: Samples, *, higher_is_better: bool = True) -> Standing:
    """The standing of methods. Errors: ValueError without a method."""
    sign = 1 if higher_is_better else -1
    means = {method: summarised(values) for method, values in samples.items()}
    order = sorted(means, key=lambda method: -sign * means[method].value)
    first, means = order[0], {method: means[method] for method in order}
    if (seeds := min(mean.seeds for mean in means.values())) < MIN_SEEDS:
        why = f"with {seeds} seed{'s' * (seeds > 1)} there is no interval, at least {MIN_SEEDS} are needed"
        return Standing(means, None, tuple(order[1:]), why)
    if len(order) == 1:
        return Standing(
            means, None, (), f"the rows have {first} alone, so there is nothing to compare it with"
        )
    rivals, spans = [], []
    for other in order[1:]:
        both = _paired(samples[first], samples[other])
        if not both:
            return Standing(means, None, (other,), f"{first} and {other} have no part and seed in common")
        advantage = summarised({pair: sign * value for pair, value in both.items()})
        if advantage.low <= 0:
            rivals.append(other)
            spans.append(f"{advantage.low:+.3f} to {advantage.high:+.3f} over {other}")
    if rivals:
        return Standing(means, None, tuple(rivals), f"the advantage of {first} is {'; '.join(spans)}")
    return Standing(means, first, (), "")


def _paired(first: Values, other: Values) -> dict[tuple[str, int], float]:
    """The differences on the parts and seeds that both have."""
    return {pair: first[pair] - other[pair] for pair in first if pair in other}


def _groups(values: Values) -> list[NDArray[np.float64]]:
    """The values of each part, over its seeds."""
    parts = sorted({part for part, _ in values})
    return [
        np.array([value for (part, _), value in sorted(values.items()) if part == name]) for name in parts
    ]


def _resampled(groups: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Bootstrap replicates of the mean, (REPLICATES,)."""
    rng = np.random.default_rng(0)
    means = np.stack(
        [
            group[rng.integers(len(group), size=(REPLICATES, len(groups), len(group)))].mean(axis=2)
            for group in groups
        ]
    )  # (parts, replicates, places): the mean of each part if it is drawn at a place
    drawn = rng.integers(len(groups), size=(REPLICATES, len(groups)))
    found: NDArray[np.float64] = np.take_along_axis(means, drawn[None], axis=0)[0].mean(axis=1)
    return found
