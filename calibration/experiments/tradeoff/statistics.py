"""What the samples of a run say: medians, intervals over rounds, and ratios to the bare trunk."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.tradeoff.timing import Samples
from calibration.metrics.summary import CONFIDENCE

__all__ = ["REPLICATES", "PressTimes", "press_times"]

REPLICATES: Final = 500

Float = NDArray[np.float64]


@dataclass(frozen=True)
class PressTimes:
    """Times of n points. stages, stages_p95: milliseconds (stages, n)."""

    stages: Float
    stages_p95: Float
    ms: Float
    """Milliseconds of a press, the sum of its stages' medians, with low and high, (3, n)."""
    p95: Float
    """Of a press, (n,), the median and how far above their median the point's own rounds reach: medians are pooled over
    points, so a percentile of its own rounds alone can be below them."""
    ratio: Float
    """The ratio of a press to the bare trunk, (3, n) as ms."""
    ratios: Float
    """The ratio in each replicate, (replicates, n), all points with the same rounds."""
    bare: float
    """Median ms."""
    rounds: int


def press_times(samples: Samples, *, seed: int, replicates: int = REPLICATES) -> PressTimes:
    """The times of every point, with 95 % bootstrap intervals over rounds.

    A replicate draws rounds, the same ones for every point, so that two points are compared on the same rounds.
    """
    rng = np.random.default_rng(seed)
    ratio_samples = samples.stages / samples.bare
    drawn = rng.integers(samples.rounds, size=(replicates, samples.rounds))
    stages = _medians(samples.stages, samples.groups)
    presses = samples.stages.sum(axis=0)
    ms = np.stack([_medians(samples.stages[:, rows], samples.groups).sum(axis=0) for rows in drawn])
    ratios = np.stack([_medians(ratio_samples[:, rows], samples.groups).sum(axis=0) for rows in drawn])
    ratio = _medians(ratio_samples, samples.groups).sum(axis=0)
    return PressTimes(
        stages=stages,
        stages_p95=stages + np.percentile(samples.stages, 95, axis=1) - np.median(samples.stages, axis=1),
        ms=_with_interval(stages.sum(axis=0), ms),
        p95=stages.sum(axis=0) + np.percentile(presses, 95, axis=0) - np.median(presses, axis=0),
        ratio=_with_interval(ratio, ratios),
        ratios=ratios,
        bare=float(np.median(samples.bare)),
        rounds=samples.rounds,
    )


def _medians(values: Float, groups: NDArray[np.int64]) -> Float:
    """The median of each stage and point over rounds, (stages, points), pooled over points of one group."""
    found = np.empty((values.shape[0], values.shape[2]))
    for stage, members in _members(groups):
        found[stage, members] = np.median(values[stage][:, members])
    return found


def _members(groups: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    for stage, of_point in enumerate(groups):
        for group in range(int(of_point.max()) + 1):
            yield stage, np.flatnonzero(of_point == group)


def _with_interval(value: Float, replicates: Float) -> Float:
    tail = 50.0 * (1.0 - CONFIDENCE)
    return np.stack([value, *np.percentile(replicates, [tail, 100.0 - tail], axis=0)])
