"""What samples of interleaved rounds say of a press."""

import numpy as np
import pytest

from calibration.experiments.tradeoff.front import WAITED
from calibration.experiments.tradeoff.timing import stage_times

STAGE_MS = np.array([[8.0, 8.0], [3.0, 6.0], [1.0, 2.0]])
"""decode, trunk and head of two points."""

APART: list[tuple[object, ...]] = [("lr", "a", "p"), ("lr", "b", "q")]
SHARED: list[tuple[object, ...]] = [("lr", "a", "p"), ("lr", "a", "q")]


def medians(shared: list[tuple[object, ...]], extra: np.ndarray, what: str = "median") -> list[list[float]]:
    """Each stage of both points, (stages, points), with something added to each round, (stages, rounds, points)."""
    times = stage_times((STAGE_MS[:, None, :] + extra).transpose(1, 2, 0), shared)
    return [[one["stages"][name][what] for one in times] for name in WAITED]


def test_the_same_work_has_one_time() -> None:
    """Two points that share a trunk get one trunk time, from the samples of both."""
    extra = np.zeros((3, 9, 2))
    extra[1, :, 0] = 4.0  # the first point's trunk took 7 ms, the second's 6
    assert medians(APART, extra) == [[8, 8], [7, 6], [1, 2]]
    assert medians(SHARED, extra)[1] == pytest.approx([6.5, 6.5])


def test_the_p95_is_not_below_the_median() -> None:
    """Seven rounds; the other point's decoding took 30 ms more, so the pooled median is far above this point's own."""
    extra = np.zeros((3, 7, 2))
    extra[0, :, 1] = 30.0
    extra[2, 5, 0] = 4.0
    assert medians(APART, extra)[0][0] == pytest.approx(23)
    assert medians(APART, extra, "p95")[0][0] == pytest.approx(23)
    assert medians(APART, extra, "p95")[2][0] == pytest.approx(1 + 0.7 * 4)
