"""The chart of ordinary presses: how seldom it is wrong, how soon it is right, and what it says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from edge.core.drift import LEARNT, MEASURES, DriftChart, H
from edge.core.reference_press.outcome import Measure

PLAIN = Measure("x", "place x", "mm", "bundle", 1e-9, 0.0, "check the fixture")


def run(values: np.ndarray, measure: Measure = PLAIN) -> tuple[int | None, DriftChart]:
    """Add the values in turn, up to the first shift that is said; returns how many it took, None for no shift."""
    chart = DriftChart()
    for number, value in enumerate(values.tolist(), 1):
        chart = chart.add(value, measure)
        if chart.shift:
            return number, chart
    return None, chart


def test_what_does_not_shift_gives_next_to_no_alarm() -> None:
    """150 runs of 1,000 values: by Siegmund's formula 2.1 alarms are expected; more than 6 are, by Poisson's
    distribution, in one of 170 such tests."""
    rng = np.random.default_rng(7)

    alarms = sum(run(rng.normal(0.0, 1.0, 1000))[0] is not None for _ in range(150))

    assert alarms <= 6


def test_neither_mean_nor_deviation_matters() -> None:
    """A shift is found after as many values, and one that is chance as well."""
    rng = np.random.default_rng(7)
    for shift in (0.0, 0.5, 1.0, 2.0) * 3:
        values = rng.normal(0.0, 1.0, 300)
        values[100:] += shift
        assert run(120 + 0.4 * values)[0] == run(values)[0]


def test_a_shift_is_found_soon_and_its_begin_is_named() -> None:
    """After 100 values one standard deviation is found after 30 in the median, two after 10; nine of ten begins are
    named to 20 values."""
    rng = np.random.default_rng(8)
    for sigmas, within in ((1.0, 30), (2.0, 10)):
        delays, begins = [], []
        for _ in range(60):
            values = rng.normal(5.0, 0.1, 300)
            values[100:] += 0.1 * sigmas
            number, chart = run(values)
            delays.append(math.inf if number is None else number - 100)
            begins.append(0 if number is None else number - chart.since)
            assert chart.shift >= 0
        assert np.median(delays) <= within
        assert sum(abs(begin - 100) <= 20 for begin in begins) >= 54


def test_one_value_far_away_is_no_shift() -> None:
    """Nor are three: each counts for three standard deviations at most."""
    chart = DriftChart()
    for value in [*np.random.default_rng(3).normal(0, 1, 50).tolist(), 1e6]:
        chart = chart.add(value, PLAIN)

    assert chart.shift == 0


@pytest.mark.parametrize(
    ("name", "usual", "floor"),
    [
        ("score_ratio", 0.1, 0.02),
        ("score_ratio", 0.8, 0.04),
        ("strength_levels", 0.1, 0.01),
        ("strength_levels", 10.0, 0.2),
        ("x_mm", 30.0, 0.05),
        ("y_mm", 30.0, 0.05),
        ("noise_levels", 0.1, 0.05),
        ("noise_levels", 2.0, 0.2),
        ("light_levels", 5.0, 0.5),
        ("light_levels", 150.0, 3.0),
    ],
)
def test_values_that_repeat_exactly_shift_by_the_floor_alone(name: str, usual: float, floor: float) -> None:
    """A twentieth of a millimetre is no other place, a sixth is; of most measures a share of what is usual counts."""
    measure = next(one for one in MEASURES if one.name == name)

    assert run(np.array([usual] * 50 + [usual + 0.8 * floor] * 100), measure)[0] is None
    number, chart = run(np.array([usual] * 50 + [usual + 3 * floor] * 50), measure)
    assert number is not None
    assert chart.describe(measure).startswith(
        f"{measure.title} is higher since about {number - 50} passing presses: "
    )


def test_a_fall_is_said_as_one() -> None:
    _, chart = run(np.array([10.0] * 30 + [5.0] * 30))

    assert chart.shift == -1
    assert "is lower" in chart.describe(PLAIN)


def test_a_shift_stays_when_its_values_become_usual() -> None:
    """All values before it, and in the end those of the shift themselves, are in the mean."""
    rng = np.random.default_rng(4)
    _, chart = run(np.concatenate([rng.normal(100, 5, 100), rng.normal(107, 5, 100)]))
    since = chart.since

    for value in rng.normal(107, 5, 1000).tolist():
        chart = chart.add(value, PLAIN)

    assert (chart.shift, chart.since) == (1, since + 1000)


def test_nothing_is_said_before_enough_is_learnt() -> None:
    early = replace(DriftChart(), count=LEARNT - 1, above=H + 1)

    assert early.shift == 0
    assert replace(early, count=LEARNT).shift == 1


def test_a_chart_is_kept_as_numbers() -> None:
    _, chart = run(np.random.default_rng(1).normal(0, 1, 30))

    assert DriftChart.from_numbers(chart.numbers) == chart
    for numbers in ([1.0], [math.nan] * 8):
        with pytest.raises(ValueError, match="8 finite numbers"):
            DriftChart.from_numbers(numbers)
    with pytest.raises(ValueError, match="finite values"):
        chart.add(math.inf, PLAIN)


def test_the_standard_normal_value_is_that_of_students_distribution() -> None:
    """Against quantiles of tables: t = 2.776 with 4 degrees of freedom and 2.086 with 20 are the normal 1.960."""
    for freedom, t in ((4, 2.776), (20, 2.086), (60, 2.000)):
        n = freedom + 1
        chart = DriftChart(count=n, mean=0.0, squares=float(freedom))  # sigma 1
        value = t / math.sqrt(n / (n + 1))
        assert chart._standardise(value, PLAIN) == pytest.approx(1.960, abs=0.02)
