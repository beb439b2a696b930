"""What samples of interleaved rounds say of a press."""

from functools import reduce
from operator import getitem
from typing import Any

import numpy as np
import pytest

from calibration.experiments.tradeoff.statistics import press_times
from calibration.experiments.tradeoff.timing import STAGES, Samples

STAGE_MS = np.array([[8.0, 8.0], [3.0, 6.0], [1.0, 2.0], [10.0, 10.0]])
"""decode, trunk, head and overlay of two points."""

APART = np.array([[0, 0], [0, 1], [0, 1], [0, 0]])


def samples(drift: np.ndarray, groups: np.ndarray = APART, extra: np.ndarray | None = None) -> Samples:
    """Rounds in which everything, the bare trunk of 7 ms too, takes `drift` times as long."""
    stages = STAGE_MS[:, None, :] * drift[None, :, None] + (0 if extra is None else extra)
    return Samples(stages, 7.0 * np.repeat(drift[:, None], 2, axis=1), groups)


def values(columns: list[dict[str, Any]], *names: str) -> Any:
    """A nested column of all points."""
    return [reduce(getitem, names, one) for one in columns]


def test_a_press_is_the_sum_of_its_stages() -> None:
    """22 and 26 ms, and their ratios to 7 ms, without any spread."""
    times, _ = press_times(samples(np.ones(9)), seed=0)
    assert values(times, "ms", "median") == values(times, "ms", "p95") == pytest.approx([22, 26])
    assert times[0]["ratio"] == pytest.approx(dict.fromkeys(("median", "low", "high"), 22 / 7))
    stages = [values(times, "stages", name, "median") for name in STAGES]
    assert np.array(stages) == pytest.approx(STAGE_MS)


def test_drift_cancels_in_the_ratio() -> None:
    """A machine that becomes three times slower during the run moves the milliseconds, not the ratio."""
    times, ratios = press_times(samples(np.linspace(1, 3, 15)), seed=0)
    assert times[0]["ms"]["high"] - times[0]["ms"]["low"] > 1
    assert times[0]["ratio"] == pytest.approx(dict.fromkeys(("median", "low", "high"), 22 / 7))
    assert np.ptp(ratios, axis=0) == pytest.approx([0, 0])


def test_the_same_work_has_one_time() -> None:
    """Two points that share a trunk get one trunk time, from the samples of both."""
    extra = np.zeros((4, 9, 2))
    extra[1, :, 0] = 4.0  # the first point's trunk took 7 ms, the second's 6
    shared = APART.copy()
    shared[1] = 0
    apart, pooled = (press_times(samples(np.ones(9), groups, extra), seed=0)[0] for groups in (APART, shared))
    assert values(apart, "stages", "trunk", "median") == pytest.approx([7, 6])
    assert values(pooled, "stages", "trunk", "median") == pytest.approx([6.5, 6.5])


def test_the_p95_is_not_below_the_median() -> None:
    """Seven rounds; the other point's decoding took 30 ms more, so the pooled median is far above this point's own."""
    extra = np.zeros((4, 7, 2))
    extra[0, :, 1] = 30.0
    extra[2, 5, 0] = 4.0
    (first, second), _ = press_times(samples(np.ones(7), extra=extra), seed=0)
    assert first["ms"]["median"] == pytest.approx(37)
    assert first["ms"]["p95"] == pytest.approx(37 + 0.7 * 4)
    assert all(stage["p95"] >= stage["median"] for one in (first, second) for stage in one["stages"].values())


def test_the_interval_covers_rounds_that_differ() -> None:
    """A stage that takes 1 ms in most rounds and 5 in some: the median's interval begins at the median of most."""
    extra = np.zeros((4, 11, 2))
    extra[2, ::3, 0] = 4.0
    times, _ = press_times(samples(np.ones(11), extra=extra), seed=0)
    assert times[0]["ms"]["low"] == pytest.approx(22)
    assert times[0]["ms"]["high"] > 22
