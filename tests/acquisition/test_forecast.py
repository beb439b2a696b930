"""Forecasts on constructed curves."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.acquisition.coverage import FARTHEST, PAYS, fall, pays_until


def hyperbola(n: int, share: float = 0.5) -> NDArray[np.float64]:
    """The unseen share `share` / m after m pieces."""
    return share / np.arange(1, n + 1)


@pytest.mark.parametrize("seen", [6, 8, 12])
def test_a_power_law_is_forecast_exactly(seen: int) -> None:
    """0.5/m falls by 0.01 a round where m (m + 4) is 200: from 13 pieces on, seen from anywhere."""
    assert pays_until(hyperbola(seen)) == 13


def test_the_fall_of_the_next_round() -> None:
    """0.5/8 to 0.5/12; of one piece, to 0.5/9. Where presses pay no more the number seen is the answer; a curve that
    has reached nothing, too."""
    assert fall(hyperbola(8)) == pytest.approx(0.5 / 8 - 0.5 / 12)
    assert fall(hyperbola(8), step=1) == pytest.approx(0.5 / 8 - 0.5 / 9)
    assert fall(hyperbola(20)) <= PAYS
    assert pays_until(hyperbola(20)) == 20
    assert pays_until(np.array([1.0, 0.2, 0.0, 0.0])) == 4


def test_no_forecast_reaches_farther_than_four_times_what_was_seen() -> None:
    """3.6/m needs 37 pieces; four seen pieces do not show that far."""
    assert pays_until(hyperbola(4, 3.6)) == FARTHEST * 4
    assert pays_until(hyperbola(16, 3.6)) == 37


def test_a_forecast_made_again_corrects_itself() -> None:
    """A curve that is steep at first and flat later: later rounds are nearer to what is needed."""

    def unseen(m: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return np.asarray(0.6 * m**-1.5 + 0.4 * m**-0.5)

    m = np.arange(1.0, 61.0)
    needed = int(m[np.argmax(unseen(m) - unseen(m + 4) <= PAYS)])
    errors = [abs(pays_until(unseen(m[:n])) - needed) for n in (4, 8, 12)]
    assert errors[2] <= errors[1] <= errors[0]
    assert errors[2] < errors[0]
    assert errors[2] <= 0.3 * needed
