"""What the samples of a run say: medians, and how far a stage reaches above them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.tradeoff.front import WAITED
from calibration.experiments.tradeoff.timing import Samples

__all__ = ["stage_times"]

Float = NDArray[np.float64]


def stage_times(samples: Samples) -> list[dict[str, Any]]:
    """Return the columns with the times of every point.

    Medians are pooled over points, so a percentile is the median and how far above their median the point's own rounds
    reach.
    """
    ms = _medians(samples.stages, samples.groups)
    tails = np.percentile(samples.stages, 95, axis=1) - np.median(samples.stages, axis=1)
    return [
        {
            "stages": {
                name: {"median": float(ms[stage, k]), "p95": float(ms[stage, k] + tails[stage, k])}
                for stage, name in enumerate(WAITED)
            },
            "rounds": samples.stages.shape[1],
        }
        for k in range(samples.groups.shape[1])
    ]


def _medians(values: Float, groups: NDArray[np.int64]) -> Float:
    """Return the median of each stage and point over rounds, (stages, points), pooled over points of one group."""
    found = np.empty((values.shape[0], values.shape[2]))
    for stage, of_point in enumerate(groups):
        for group in np.unique(of_point):
            found[stage, of_point == group] = np.median(values[stage][:, of_point == group])
    return found
