"""A ball's contact is found in the picture, and the fit predicts what the renderer draws."""

import numpy as np
import pytest
from ball_presses import PLACES_MM, RADIUS_MM, UNSEEN, frames, planes

from calibration.sensor_fit.ball import Ball, ball_height, find_circle
from calibration.sensor_fit.prediction import predict, window_around
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.renderer import Renderer


def test_a_disc_is_found_where_it_is() -> None:
    """A disc of 30 pixels about (200, 90) that changes by 40 levels: centre and radius within a pixel.
    An untouched gel's noise of 2 levels is below every limit."""
    rows, columns = np.mgrid[0:240, 0:320]
    change = np.zeros((3, 240, 320), np.float32)
    change[:, np.hypot(columns - 200, rows - 90) <= 30] = 40
    circle = find_circle(change)
    assert circle is not None
    assert (circle.x, circle.y) == pytest.approx((200, 90), abs=1)
    assert circle.radius == pytest.approx(30, abs=2)
    noise = np.random.default_rng(0).normal(0, 2, (3, 240, 320)).astype(np.float32)
    assert find_circle(noise) is None


@pytest.mark.parametrize("place", PLACES_MM)
def test_a_ball_is_found_within_a_third_of_a_millimetre(place: tuple[float, float]) -> None:
    """Where its light falls off to the corners too; the fit goes on from there."""
    free, pressed = frames([place])
    circle = find_circle(planes(pressed) - planes(free))
    assert circle is not None
    found = circle.ball(RADIUS_MM)
    assert np.hypot(found.x_mm - place[0], found.y_mm - place[1]) < 0.33


def test_the_prediction_is_the_renderers_picture() -> None:
    """For one response, gel and ball both give the same change, within 2 levels at the rim and 0.3 in the mean."""
    ball = Ball(1.3, -2.1, 0.3)
    still = Renderer(LR, _STILL, UNSEEN)
    height = ball_height(ball, RADIUS_MM, *grids(LR))
    free = still.light(np.zeros(LR.shape, np.float32))
    drawn = still.light(still.imprint(height, 0.0)) - free
    window = window_around(ball, ball.contact_radius_mm(RADIUS_MM))
    assert UNSEEN.height_response is not None
    response = np.concatenate([UNSEEN.slope_response, UNSEEN.height_response], axis=1)
    seen = predict(ball, RADIUS_MM, UNSEEN.gel, free, window)
    error = np.abs(drawn[:, *window] - seen.change(response))[:, seen.changed]
    assert error.mean() < 0.3
    assert error.max() < 2


_STILL = ("deformation", "illumination", "shadows", "specular", "vignette", "lens_blur")
