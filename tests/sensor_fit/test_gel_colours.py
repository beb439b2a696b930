"""The free gel of a sensor: its noise and its marker dots."""

from dataclasses import replace

import numpy as np
import pytest
from ball_presses import UNSEEN, planes, renderer

from calibration.sensor_fit.gel_colours import fit_noise, has_markers, marker_dots
from calibration.simulator.camera import noise, noise_spread
from calibration.simulator.field_of_view import LR
from calibration.simulator.renderer import Renderer


def test_the_noise_that_was_added_is_found() -> None:
    """Sd 1.0, 2.0 and 3.0 at a level of 60: found within a tenth, whatever dirt both frames show."""
    dirt = np.random.default_rng(1).normal(0, 5, (3, *LR.shape)).astype(np.float32)
    free = np.full((3, *LR.shape), 60, np.float32)
    spread = noise_spread(free + dirt, (1.0, 2.0, 3.0))
    drawn = [noise(free + dirt, np.random.default_rng(k), spread) - free for k in range(3)]
    everywhere = np.ones(LR.shape, np.bool_)
    assert fit_noise(drawn, [everywhere] * 3, (60, 60, 60)) == pytest.approx((1, 2, 3), rel=0.1)


def test_a_renderer_draws_the_noise_of_its_sensor() -> None:
    """None where the sensor has none; with 6 levels the green differs by more than 2."""
    quiet, noisy = (replace(UNSEEN, noise_sd=(0.0, sd, 0.0)) for sd in (0.0, 6.0))
    drawn = [Renderer(LR, ("illumination", "noise"), one).free_gel().astype(float) for one in (quiet, noisy)]
    spread = (drawn[1] - drawn[0]).std(axis=(0, 1))
    assert spread[1] > 2
    assert spread[0] == spread[2] == 0


def test_a_marker_gel_differs_from_a_plain_one() -> None:
    """7 x 9 dots of 6 pixels radius, with a rim, and no more than a quarter of the view; grain and dust are not."""
    marked = planes(renderer(markers=True).free_gel())
    assert has_markers(marked)
    assert not has_markers(planes(renderer().free_gel()))
    assert 63 * 36 * np.pi < marker_dots(marked).sum() < 0.25 * marked[0].size
