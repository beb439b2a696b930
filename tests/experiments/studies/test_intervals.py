"""Intervals of few draws hold the true mean as often as they say, and seeds without other presses are no draws."""

import math
from typing import Any

import numpy as np
import pytest

from calibration.experiments.harness.intervals import MIN_DRAWS, is_drawn, mean_interval


@pytest.mark.parametrize("draws", [3, 5, 10])
def test_an_interval_holds_the_mean_in_95_of_100_cases(draws: int) -> None:
    """Of 4,000 simulated sets of few values; the percentiles of a bootstrap hold it in 74, 84 and 90 %."""
    sets = np.random.default_rng(draws).normal(size=(4000, draws))
    held = np.mean([low <= 0 <= high for low, high in map(mean_interval, sets)])

    assert held == pytest.approx(0.95, abs=0.012)


def test_fewer_draws_have_no_interval() -> None:
    """Nothing is printed that two values cannot show."""
    assert all(math.isnan(end) for end in mean_interval(np.arange(MIN_DRAWS - 1.0)))
    assert mean_interval(np.full(MIN_DRAWS, 0.5)) == (0.5, 0.5)


@pytest.mark.parametrize("span", [(0.0, 1.0), (-1.0, 1.0), (0.0, math.inf)])
def test_an_interval_stays_within_the_range_of_its_measure(span: tuple[float, float]) -> None:
    """Three parts, of which one is lost: Student's t alone gives -0.68 to 1.85. Far from the ends both are the same."""
    low, high = mean_interval(np.array([0.0, 0.86, 0.9]), *span)
    assert span[0] < low < 0.587 < high < span[1]

    close = np.array([0.50, 0.51, 0.52])
    assert mean_interval(close, *span) == pytest.approx(mean_interval(close), abs=2e-3)
    assert mean_interval(np.zeros(3), *span) == (0.0, 0.0)
    assert mean_interval(np.array([0.0, 0.0, 1e-9]), *span)[1] <= span[1]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({"presses": 22, "pool": 110, "fraction": 0.2}, True),
        ({"presses": 110, "pool": 110, "fraction": 1.0}, False),
        ({"presses": 8, "pool": 110, "shots": 8, "fraction": math.nan}, True),
        ({"presses": 12, "pool": 110, "most_presses": 12, "fraction": 0.6}, False),
        (
            {
                "presses": 12,
                "pool": 110,
                "most_presses": 12,
                "fraction": 0.6,
                "target_fraction": math.nan,
                "bad": math.nan,
            },
            False,
        ),
        ({"presses": 11, "pool": 110, "most_presses": 24, "fraction": 0.1}, True),
        ({"presses": 116, "pool": 110, "fraction": 1.0, "target_fraction": 0.05}, True),
        ({"presses": 110, "pool": 110, "fraction": 1.0, "target_fraction": 0.0}, False),
        ({"presses": 66, "fraction": 0.6, "target_fraction": 0.0}, True),
        ({"presses": 110, "fraction": 1.0, "bad": 0.1}, True),
        ({"presses": 110, "fraction": 1.0, "bad": 0.0}, False),
    ],
)
def test_a_seed_draws_presses_unless_all_are_learnt(row: dict[str, Any], expected: bool) -> None:
    """Of every study: the pool, its cap, the second position and the damaged presses."""
    assert is_drawn(row) is expected
