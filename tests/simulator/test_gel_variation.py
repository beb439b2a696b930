"""Simulated gels of one sensor: what a new pad changes, and what it leaves as it is."""

import numpy as np

from calibration.simulator.field_of_view import LR
from calibration.simulator.sensor_appearance import SENSORS, another_gel, background

UNIT = SENSORS["unit_b"]
GELS = [another_gel(UNIT, np.random.default_rng(seed)) for seed in range(20)]


def test_gels_differ_less_than_units() -> None:
    """The free gel of another pad, in levels, lies nearer than that of another unit in the median."""
    own = background(UNIT, LR)
    units = [float(np.abs(background(SENSORS[name], LR) - own).mean()) for name in ("unit_a", "unit_c")]
    gels = [float(np.abs(background(gel, LR) - own).mean()) for gel in GELS]

    assert 1.0 < np.median(gels) < min(units)


def test_a_coat_answers_up_to_a_third_more_or_less() -> None:
    """The common strength is clipped at .3 in the logarithm, each colour adds a little."""
    strength = np.array([gel.slope_response[:, 0] / UNIT.slope_response[:, 0] for gel in GELS])

    assert 0.6 < strength.min() < 0.95
    assert 1.05 < strength.max() < 1.7
