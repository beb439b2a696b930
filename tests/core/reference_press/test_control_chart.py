"""Limits of individual values and run rules, against published numbers and a simulation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.reference_press.charts import Limits, signals
from edge.core.reference_press.outcome import Signal

# NIST/SEMATECH e-Handbook of Statistical Methods, section 6.3.2.2: flow rates of ten batches.
FLOW_RATES = (49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1)
UNIT = Limits(0.0, 1.0)


def test_the_limits_are_those_of_the_published_example() -> None:
    """NIST's example: centre 50.81, mean moving range 1.8778, limits 45.8159 and 55.8041."""
    limits = Limits.of(FLOW_RATES, floor=1e-9)

    assert limits.centre == pytest.approx(50.81)
    assert limits.sigma * 1.128 == pytest.approx(1.8778, abs=5e-5)
    assert (limits.low, limits.high) == pytest.approx((45.8159, 55.8041), abs=1e-4)


@settings(deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=30), st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_limits_move_with_the_values(values: list[float], shift: float, scale: float) -> None:
    """Another zero and another unit give the same chart."""
    limits = Limits.of(values, 1e-9)
    moved = Limits.of([scale * value + shift for value in values], 1e-9 * scale)

    assert moved.centre == pytest.approx(scale * limits.centre + shift, rel=1e-6, abs=1e-6 * scale + 1e-6)
    assert moved.sigma == pytest.approx(scale * limits.sigma, rel=1e-4, abs=1e-5)


def test_values_that_repeat_exactly_have_the_floor_as_sigma() -> None:
    """A recording that is played again must not make every other value an alarm."""
    limits = Limits.of([2.0] * 5, floor=0.1)

    assert (limits.low, limits.high) == pytest.approx((1.7, 2.3))
    assert signals([2.0] * 5 + [2.29], limits) == ()


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0, 0, 3.01], (Signal.BEYOND_LIMIT,)),
        ([0, 0, -3.01], (Signal.BEYOND_LIMIT,)),
        ([0, 0, 2.99], ()),
        ([2.1, 0, 2.1], (Signal.TWO_OF_THREE,)),
        ([2.1, 2.1, 0], ()),
        ([2.1, 0, -2.1], ()),
        ([2.1, 0, 0, 2.1], ()),
        ([0.1] * 8, (Signal.RUN_OF_EIGHT,)),
        ([-0.1] * 8, (Signal.RUN_OF_EIGHT,)),
        ([0.1] * 7, ()),
        ([0.1] * 7 + [-0.1], ()),
        ([-0.1] + [0.1] * 7, ()),
        ([], ()),
    ],
)
def test_the_rules_are_those_of_the_handbook(values: list[float], expected: tuple[Signal, ...]) -> None:
    """Worked by hand in standard deviations."""
    assert signals(values, UNIT) == expected


def test_false_alarms_are_as_rare_as_published() -> None:
    """Champ and Woodall 1987: 122 values between two alarms of rules 1, 2 and 4, 370 with rule 1 alone."""
    rng = np.random.default_rng(1)
    counts = {"all": 0, "first": 0}
    lengths = {"all": 0, "first": 0}
    window: list[float] = []
    first = 0
    for value in rng.standard_normal(60_000):
        window = [*window[-7:], float(value)]
        lengths["all"] += 1
        found = signals(window, UNIT)
        first += Signal.BEYOND_LIMIT in found
        if found:
            counts["all"] += 1
            window = []

    assert lengths["all"] / counts["all"] == pytest.approx(122, rel=0.12)
    assert 60_000 / first == pytest.approx(370, rel=0.2)


@pytest.mark.parametrize("values", [[], [1.0]])
def test_limits_need_two_values(values: list[float]) -> None:
    """One value has no moving range."""
    with pytest.raises(ValueError, match="two values or more"):
        Limits.of(values, 0.1)


@pytest.mark.parametrize(("centre", "sigma"), [(0.0, 0.0), (0.0, -1.0), (float("nan"), 1.0)])
def test_limits_are_numbers(centre: float, sigma: float) -> None:
    with pytest.raises(ValueError, match="sigma is above 0"):
        Limits(centre, sigma)
