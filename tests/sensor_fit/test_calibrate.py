"""A sensor that the product does not ship, calibrated from presses of a ball; and every input that cannot serve."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from ball_presses import PLACES_MM, RADIUS_MM, UNSEEN, frames, nominal, renderer, without_free_gel

from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.sensor_fit.calibrate import Calibrated, calibrate_sensor, divide
from calibration.simulator.sensor_appearance import SENSORS
from edge.core.errors import FitError


@pytest.fixture(scope="module")
def shown() -> list[np.ndarray]:
    return frames()


@pytest.fixture(scope="module")
def made(shown: list[np.ndarray]) -> Calibrated:
    return calibrate_sensor(nominal(shown), "unseen", RADIUS_MM)


def test_held_out_presses_are_predicted(made: Calibrated) -> None:
    """Of a change of 15 levels and more less than 4 are left, rms: noise, grain and compression."""
    assert [one.name for one in made.judged] == ["0", "1", "2", "3", "4", "5"]
    assert min(one.signal for one in made.judged) > 15
    fitted = made.sensor.fitted
    assert fitted is not None
    assert fitted.inside_levels < 4
    assert fitted.outside_levels < 2
    assert (fitted.presses, fitted.ball_radius_mm) == (6, RADIUS_MM)
    assert (made.warnings, made.left_out) == ((), {})


def test_the_sensor_is_recovered(made: Calibrated) -> None:
    """Red to a vertical slope and green to a horizontal one, at the view's centre, within a tenth; what a raised gel
    adds, 15, 6 and 12 levels per mm, within 8, for a ball's flat pole shows it; the free gel within 2 levels."""
    response = np.array(made.sensor.slope_response)
    assert response[[0, 1], [6, 0]] == pytest.approx(UNSEEN.slope_response[[0, 1], [6, 0]], rel=0.1)
    assert np.array(made.sensor.height_response)[:, 0] == pytest.approx([15, 6, 12], abs=8)
    own, fitted = (renderer(sensor=one).free_gel() for one in (UNSEEN, made.sensor.appearance))
    assert np.abs(own.astype(np.float32) - fitted).mean() < 2


@pytest.fixture(scope="module")
def few(shown: list[np.ndarray]) -> Calibrated:
    """Three balls and a flat square."""
    square = shown[0].copy()
    square[80:150, 120:200] = np.clip(square[80:150, 120:200].astype(int) + 60, 0, 255).astype(np.uint8)
    return calibrate_sensor(nominal([*shown[:4], square]), "unseen", RADIUS_MM)


def test_a_press_of_something_else_is_named_and_left_out(few: Calibrated) -> None:
    """The flat square; the balls are fitted without it."""
    assert list(few.left_out) == ["3"]
    assert "of its change does not follow the slopes of a ball" in few.left_out["3"]
    assert [one.name for one in few.judged] == ["0", "1", "2"]


def test_the_diameter_in_place_of_the_radius_is_suspected(shown: list[np.ndarray]) -> None:
    """Slopes are then half as steep, so colours seem to answer twice as strongly; the sentence names the cause."""
    made = calibrate_sensor(nominal(shown[:4]), "unseen", 2 * RADIUS_MM)
    assert len(made.warnings) == 1
    assert "check the ball's radius (not its diameter)" in made.warnings[0]


def test_markers_are_left_out_of_the_fit() -> None:
    """On a marker gel dots cover what is below them; what is between them is predicted, and it is said."""
    made = calibrate_sensor(nominal(frames(PLACES_MM[:4], markers=True)), "unseen", RADIUS_MM)
    assert made.sensor.fitted is not None
    assert made.sensor.fitted.has_markers
    assert any("name the effect 'markers'" in warning for warning in made.warnings)
    assert made.sensor.fitted.inside_levels < 9


def test_too_few_presses_are_refused_with_every_reason(shown: list[np.ndarray]) -> None:
    """Two presses; a third picture shows nothing, and is named."""
    with pytest.raises(FitError, match=r"2 presses of the ball can be used, at least 3 are needed") as caught:
        calibrate_sensor(nominal([*shown[:3], renderer().free_gel(("again",))]), "unseen", RADIUS_MM)
    assert "2: no contact was found in it" in str(caught.value)


def burnt(shown: list[np.ndarray]) -> np.ndarray:
    """A press of which the contact is at the end of a channel, so that it tells no slopes."""
    press = shown[5].copy()
    press[np.abs(press.astype(int) - shown[0]).max(axis=2) > 12] = 255
    return press


@pytest.mark.parametrize(
    ("presses", "radius_mm", "sentence"),
    [
        (lambda s: without_free_gel(nominal(s)), RADIUS_MM, "give one with --no-contact"),
        (
            lambda s: replace(nominal(s), estimated="estimated", faults=("the picture is foreign",)),
            RADIUS_MM,
            "give one with --no-contact.*; the picture is foreign",
        ),
        (nominal, 9, r"radius 9 mm is larger than the view, which is 15\.2 mm high"),
        (nominal, 0.8, r"radius 0\.80 mm cannot leave contacts of 1\.\d\d mm radius"),
        (
            lambda s: nominal([renderer(sensor=SENSORS["unit_b"]).free_gel(), *s[1:]]),
            RADIUS_MM,
            "the free gel is not that of these presses: 6 of 6 differ",
        ),
        (
            lambda s: nominal([*s[:3], burnt(s)]),
            RADIUS_MM,
            r"2: \d+% of its contact is saturated; lower the exposure",
        ),
        (
            lambda s: nominal([*s[:3], *frames([(9.8, 0.0)])[1:]]),
            RADIUS_MM,
            "2: its contact reaches beyond the view",
        ),
    ],
)
def test_presses_that_cannot_serve_are_refused(
    shown: list[np.ndarray],
    presses: Callable[[list[np.ndarray]], NominalPresses],
    radius_mm: float,
    sentence: str,
) -> None:
    """No free gel, an impossible ball, the gel of another sensor, and presses that tell nothing."""
    with pytest.raises(FitError, match=sentence):
        calibrate_sensor(presses(shown), "unseen", radius_mm)


def test_of_many_presses_twenty_are_fitted(shown: list[np.ndarray]) -> None:
    """They are spread over all; the others are judged only."""
    fitted, others = divide(list(range(45)))
    assert (len(fitted), len(others)) == (20, 25)
    assert (fitted[0], fitted[-1]) == (0, 44)
    assert divide([1, 2, 3]) == ([1, 2, 3], [])
