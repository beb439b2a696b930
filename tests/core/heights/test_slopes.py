"""Slopes beside an oracle: the float64 minimum of the same weighed difference, found pixel by pixel."""

import numpy as np
import scipy
from lit_surface import MM_PER_PX, calibration, grid

from edge.core.arrays import F64
from edge.core.heights.calibration import SIZE, place_powers, surface_terms
from edge.core.heights.height_map import SlopeFinder


def find_minimum(response: F64, rest: F64, height: float, seen: F64) -> F64:
    """Return the slopes to the right and down whose colours are nearest to those seen. response: (3, 6)."""
    white = np.linalg.cholesky(np.linalg.inv(rest)).T

    def differ(part: F64) -> F64:
        return np.asarray(white @ (response @ surface_terms(part, np.float64(height)) - seen))

    found = scipy.optimize.least_squares(differ, np.zeros(2), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    part = found.x
    return np.asarray(-part / np.sqrt(1 - part @ part))


def test_the_powers_of_a_place_are_worked_by_hand() -> None:
    """From -1 to 1 over the whole picture, of which a part may be asked for: here its right half."""
    for box, across in (((0, 0, 1, 1), (-0.5, 0.5)), ((0.5, 0, 1, 1), (0.25, 0.75))):
        by_hand = [[(1, u, v, u * u, v * v, u * v) for u in across] for v in (-0.5, 0.5)]
        np.testing.assert_allclose(place_powers((2, 2), box), np.moveaxis(by_hand, -1, 0))


def test_slopes_are_those_of_the_exact_minimum() -> None:
    """Of a ball under noise that no surface gives. Three calls of three steps in float32 are within 0.001 of a slope at
    every pixel that is tried."""
    made, powers, rng = calibration(), place_powers(SIZE), np.random.default_rng(7)
    x, y = grid()
    raised = np.maximum(np.sqrt(np.maximum(36 - x * x - y * y, 0)) - 5.1, 0)
    down, across = np.gradient(raised, MM_PER_PX)
    normal = np.stack([-across, -down]) / np.sqrt(across**2 + down**2 + 1)
    change = np.einsum("ctp,phw,thw->chw", made.response, powers, surface_terms(normal, raised))
    change = (change + rng.normal(0, 2, change.shape)).astype(np.float32)
    light = np.array([0.9, 1.0, 1.1])

    finder = SlopeFinder(made, powers, light)
    for _ in range(3):
        slopes = np.stack(finder.find(change, raised))

    for row, column in rng.integers((0, 0), SIZE[::-1], (200, 2)):
        response = light[:, None] * (made.response @ powers[:, row, column])
        exact = find_minimum(response, made.rest, raised[row, column], change[:, row, column])
        assert np.abs(slopes[:, row, column] - exact).max() < 1e-5
