"""Slopes in colours: learnt from the presses, and turned as the part turns."""

import math

import cv2
import numpy as np
import pytest
import turned_parts as parts

from edge.core.registration.colours import SlopeColours, curl_share


def _colours(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Slopes without a preferred direction, and their colours."""
    slopes = np.random.default_rng(seed).normal(0, 0.2, (20000, 2))
    return slopes, (slopes @ parts.SENSOR.T).astype(np.float32)


def _error(found: SlopeColours, turn: float) -> float:
    """How far turned colours are from the colours of turned slopes, levels."""
    slopes, colours = _colours(1)
    cos, sin = math.cos(turn), math.sin(turn)
    turned = slopes @ np.array([[cos, sin], [-sin, cos]]) @ parts.SENSOR.T
    return float(np.abs(colours @ found.turn_matrix(turn).T - turned).max())


def test_colours_turn_with_the_part() -> None:
    """Learnt without a calibration, but for a reflection: one of the two turns colours as the sensor does."""
    learnt = SlopeColours.of(_colours()[1])
    right, wrong = sorted((learnt, learnt.mirror()), key=lambda one: _error(one, 1.2))

    assert _error(right, 1.2) < 1.5
    assert _error(wrong, 1.2) > 20


@pytest.mark.parametrize("turn_rad", [0.0, 0.7, 2.0])
def test_only_the_right_colours_show_a_surface(turn_rad: float) -> None:
    """In whatever turn of the slopes; by the reflection about half of their change is curl."""
    rng = np.random.default_rng(0)
    height = cv2.GaussianBlur(rng.normal(size=(80, 90)), (0, 0), 4)
    down, across = np.gradient(height)
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    slopes = np.stack([cos * across - sin * down, sin * across + cos * down], axis=2).astype(np.float32)
    assert curl_share(slopes) < 1e-3
    assert curl_share(slopes * np.float32([1, -1])) > 0.4
    assert curl_share(np.zeros_like(slopes)) == 0


def test_what_is_no_slope_stays() -> None:
    """A light that is added to all colours in a way that no slope adds is not turned."""
    colours = SlopeColours.of(_colours()[1])
    no_slope = np.cross(*colours.matrix.T)

    np.testing.assert_allclose(colours.turn_matrix(2.0) @ no_slope, no_slope, rtol=1e-9)


def test_a_light_from_one_side_is_refused() -> None:
    """Colours of one direction alone do not show how a part lies."""
    slopes = np.random.default_rng(0).normal(size=(500, 1))

    with pytest.raises(ValueError, match="one direction"):
        SlopeColours.of((slopes @ [[1.0, 2.0, 3.0]]).astype(np.float32))
