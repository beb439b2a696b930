"""The measures of one point."""

import numpy as np
import pytest

from calibration.experiments.tradeoff.accuracy import MEASURES, Truth, measure_accuracy
from calibration.metrics.summary import recall_at, specimen_weights

SCORES = np.array([1.0, 2.0, 3.0, 4.0, 3.5, 5.0, 6.0])
IS_DEFECTIVE = np.array([False, False, False, False, True, True, True])


def weighted(*rows: list[float]) -> np.ndarray:
    return recall_at(SCORES, IS_DEFECTIVE, np.array(rows, np.float64), rate=0.25)


def test_recall_counts_presses_above_the_lowest_allowed_threshold() -> None:
    """One of four sound presses may alarm: the threshold is 3, and all three defective presses are above it."""
    assert weighted([1] * 7) == pytest.approx([1.0])
    strict = recall_at(SCORES, IS_DEFECTIVE, np.ones((1, 7)), rate=0.01)
    assert strict == pytest.approx([2 / 3])


def test_a_replicate_counts_presses_as_often_as_they_are_drawn() -> None:
    """With the sound press of 4 drawn twice of four, it may not alarm; a defective one drawn twice counts twice."""
    assert weighted([1, 1, 0, 2, 2, 1, 0]) == pytest.approx([1 / 3])


def test_a_replicate_without_a_class_has_no_recall() -> None:
    """NaN, which an interval leaves out."""
    assert np.isnan(weighted([1, 1, 1, 1, 0, 0, 0])).all()
    assert np.isnan(weighted([0, 0, 0, 0, 1, 1, 1])).all()


def test_equal_scores_alarm_together() -> None:
    """Two sound presses with the same score are both above a lower threshold, or none is."""
    found = recall_at(
        np.array([1.0, 2.0, 2.0, 3.0]), np.array([False, False, False, True]), np.ones((1, 4)), 0.5
    )
    assert found == pytest.approx([1.0])
    low = recall_at(
        np.array([1.0, 2.0, 2.0, 1.5]), np.array([False, False, False, True]), np.ones((1, 4)), 0.5
    )
    assert low == pytest.approx([0.0])


def test_a_perfect_map_has_every_measure_at_one() -> None:
    """Value and both ends of the interval; pieces are drawn, so the interval needs several of each class."""
    masks = [np.zeros((8, 8), np.bool_) for _ in range(8)]
    for mask in masks[4:]:
        mask[2:4, 2:4] = True
    label = np.arange(8) >= 4
    drawn = specimen_weights([str(k) for k in range(8)], label, 50, np.random.default_rng(0))
    truth = Truth(label, masks, np.concatenate([np.ones((1, 8)), drawn]))
    scores = (np.arange(8) >= 4).astype(np.float64)
    found = measure_accuracy([mask.astype(np.float32) for mask in masks], scores, truth)
    assert list(found) == list(MEASURES)
    assert all(one == pytest.approx({"value": 1.0, "low": 1.0, "high": 1.0}) for one in found.values())
