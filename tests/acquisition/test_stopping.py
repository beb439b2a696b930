"""When presses are enough, and what the acquisition says of it."""

import numpy as np
import pytest

from calibration.acquisition.command import alpha
from calibration.acquisition.coverage import Coverage, Standing
from calibration.acquisition.report import forecast_lines, promise_line
from calibration.fitting.limits.threshold import conformal_threshold


def coverage(presses: int, unseen: int) -> Coverage:
    """One row of 100 cells: `unseen` of them have no neighbour on any press, all others have all."""
    neighbours = np.full((presses, 1, 100), presses - 1, np.int64)
    neighbours[:, :, :unseen] = 0
    return Coverage(1.0, neighbours, np.ones((1, 100), np.bool_), presses)


@pytest.mark.parametrize(
    ("rate", "confidence", "presses"), [(0.1, 0.9, 22), (0.05, 0.9, 45), (0.1, 0.95, 29)]
)
def test_what_a_goal_needs(rate: float, confidence: float, presses: int) -> None:
    """Presses without an alarm."""
    assert Standing(0, None, None, rate, confidence).promised_at == presses


@pytest.mark.parametrize(
    ("presses", "unseen", "is_covered", "is_enough", "needed"),
    [
        (7, 0, False, False, None),  # seven presses alike may be luck
        (8, 0, True, False, 14),
        (10, 0, True, False, 12),
        (21, 0, True, False, 1),
        (22, 0, True, True, 0),
        (30, 0, True, True, 0),
        (22, 10, True, True, 0),  # what differs on every press is not pressed for ever
        (10, None, False, False, None),
        (22, None, False, False, None),
    ],
)
def test_enough_is_promise_and_coverage(
    presses: int, unseen: int | None, is_covered: bool, is_enough: bool, needed: int | None
) -> None:
    """21 presses promise too little; 22 that show nothing new are enough; without a coverage nothing is known."""
    standing = Standing(presses, None, None if unseen is None else coverage(presses, unseen))
    assert (standing.is_covered, standing.is_enough) == (is_covered, is_enough)
    assert needed is None or standing.still_needed == needed
    assert unseen is not None or standing.still_needed is None


def test_presses_that_show_something_new_are_not_enough() -> None:
    """Every cell of 22 presses has one near neighbour alone: four more presses would show others."""
    neighbours = np.ones((22, 1, 4), np.int64)
    neighbours[::2] = 0
    standing = Standing(22, None, Coverage(1.0, neighbours, np.ones((1, 4), np.bool_), 22))
    assert standing.fall is not None
    assert standing.fall > 0.01
    assert not standing.is_enough
    assert standing.still_needed


def test_the_promise_in_words() -> None:
    """31 presses of 9 pieces; one number where each press is a piece; 12 presses of a gel rated for 500."""
    by_piece, by_press = (promise_line(Standing(*standing, None)) for standing in ((31, 9), (22, None)))
    assert by_piece.startswith("31 presses of 9 pieces: at most 7.2 % false alarms by press, 23 % by piece")
    assert by_press.startswith("22 presses: at most 10 % false alarms")
    assert promise_line(Standing(22, 22, None)) == by_press
    of_one = "12 presses of 1 piece: at most 18 % false alarms by press, nothing promised of other pieces, 90 % sure"
    assert promise_line(Standing(12, 1, None)).startswith(of_one)
    assert Standing(12, 1, None).by_piece is None
    (forecast,) = forecast_lines(Standing(10, None, coverage(10, 0)), 500)
    assert "12 more presses, 22 in all" in forecast
    assert "2.4 % of a gel" in forecast


@pytest.mark.parametrize("pieces", [4, 12, 19, 22, 38, 45, 120])
@pytest.mark.parametrize("each", [1, 4])
def test_the_fit_keeps_the_promise(pieces: int, each: int) -> None:
    """At the rate that the printed command asks for, no nominal press lies above the threshold."""
    standing = Standing(pieces * each, pieces, None)
    names = [str(k // each) for k in range(pieces * each)]
    limit = conformal_threshold(np.arange(float(len(names))), alpha(standing), specimens=names)
    assert limit.by_press is not None
    assert limit.by_press.alarms == 0
    assert limit.by_press.rate == pytest.approx(standing.rate(standing.presses))
