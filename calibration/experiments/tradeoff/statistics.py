"""What the samples of a run say: medians, intervals over rounds, and ratios to the bare trunk."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.tradeoff.timing import STAGES, Samples
from calibration.metrics.summary import CONFIDENCE

__all__ = ["press_times"]

REPLICATES: Final = 500

Float = NDArray[np.float64]


def press_times(
    samples: Samples, *, seed: int, replicates: int = REPLICATES
) -> tuple[list[dict[str, Any]], Float]:
    """Return the columns with the times of every point, and its ratios to the bare trunk, (replicates, n).

    Milliseconds of a press are the sum of its stages' medians; intervals are 95 %, bootstrapped over rounds. A
    replicate draws rounds, the same ones for every point, so that two points are compared on the same rounds. Medians
    are pooled over points, so a percentile is the median and how far above their median the point's own rounds reach.
    """
    rng = np.random.default_rng(seed)
    drawn = rng.integers(samples.rounds, size=(replicates, samples.rounds))
    ms, ms_drawn = _medians_of_rounds(samples.stages, samples.groups, drawn)
    ratio, ratio_drawn = _medians_of_rounds(samples.stages / samples.bare, samples.groups, drawn)
    tails = {
        name: np.percentile(values, 95, axis=-2) - np.median(values, axis=-2)
        for name, values in (("stages", samples.stages), ("press", samples.stages.sum(axis=0)))
    }
    columns = [
        {
            "ms": _interval(ms[:, k].sum(), ms_drawn[:, k])
            | {"p95": float(ms[:, k].sum() + tails["press"][k])},
            "stages": {
                name: {"median": float(ms[stage, k]), "p95": float(ms[stage, k] + tails["stages"][stage, k])}
                for stage, name in enumerate(STAGES)
            },
            "ratio": _interval(ratio[:, k].sum(), ratio_drawn[:, k]),
            "bare_trunk_ms": float(np.median(samples.bare)),
            "rounds": samples.rounds,
        }
        for k in range(samples.groups.shape[1])
    ]
    return columns, ratio_drawn


def _medians_of_rounds(
    values: Float, groups: NDArray[np.int64], drawn: NDArray[np.int64]
) -> tuple[Float, Float]:
    """Return the medians of each stage and point, and the sum over stages in each replicate, (replicates, points)."""
    return _medians(values, groups), np.stack(
        [_medians(values[:, rows], groups).sum(axis=0) for rows in drawn]
    )


def _medians(values: Float, groups: NDArray[np.int64]) -> Float:
    """Return the median of each stage and point over rounds, (stages, points), pooled over points of one group."""
    found = np.empty((values.shape[0], values.shape[2]))
    for stage, of_point in enumerate(groups):
        for group in np.unique(of_point):
            found[stage, of_point == group] = np.median(values[stage][:, of_point == group])
    return found


def _interval(value: float, drawn: Float) -> dict[str, float]:
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(drawn, [tail, 100.0 - tail])
    return {"median": float(value), "low": float(low), "high": float(high)}
