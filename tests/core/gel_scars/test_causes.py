"""Gel or part: the rules, each with the case that it is for."""

import numpy as np
import pytest

from edge.core.gel_scars.causes import blame, doubt, remaining, together
from edge.core.gel_scars.record import Repeats
from edge.core.verdict import Blame, Cause

NEVER = Repeats()
FIXTURE = Repeats(hits=3.5, rate=1.0, spread_mm=0.1)
"""In each of the last presses, with the part at one place."""


@pytest.mark.parametrize(
    ("left", "repeats", "wide_mm", "cause"),
    [
        (0.0, NEVER, 1.0, Cause.GEL),  # it is gone without the marks
        (0.2, NEVER, 1.0, Cause.GEL),
        (0.25, NEVER, 1.0, Cause.UNSURE),  # the marks explain a part of it
        (0.5, FIXTURE, 1.0, Cause.UNSURE),
        (0.6, NEVER, 1.0, Cause.PART),
        (1.0, NEVER, 1.0, Cause.PART),
        (None, NEVER, 1.0, Cause.UNSURE),  # the free gel was not seen
        (1.0, FIXTURE, 1.0, Cause.PART),  # pieces damaged at one place in a fixture: the free gel decides
        (None, FIXTURE, 1.0, Cause.UNSURE),
        (1.0, Repeats(6.0, 1.0, 0.1), 1.0, Cause.UNSURE),  # so often that a tool or the gel is likely
        (1.0, Repeats(6.0, 0.3, 0.1), 1.0, Cause.PART),  # often, and mostly not
        (1.0, Repeats(3.0, 1.0, 1.4), 1.0, Cause.GEL),  # the part moved, the place did not
        (None, Repeats(3.0, 1.0, 1.4), 1.0, Cause.GEL),
        (1.0, Repeats(3.0, 1.0, 1.4), 2.0, Cause.PART),  # a place as wide as the movement
        (1.0, Repeats(2.0, 1.0, 1.4), 1.0, Cause.PART),  # twice is not yet a rule
        (1.0, Repeats(3.0, 0.4, 1.4), 1.0, Cause.PART),  # most presses are quiet there
    ],
)
def test_each_rule(left: float | None, repeats: Repeats, wide_mm: float, cause: Cause) -> None:
    """As docs/gel.md says, with a sentence why."""
    found = blame(left, repeats, wide_mm)

    assert found.cause is cause
    assert len(found.why.split()) >= 6


def test_damage_counts_before_doubt_and_doubt_before_the_gel() -> None:
    """A press with a scar and damage is a damaged part."""
    part, unsure, gel = (Blame(cause, "why") for cause in (Cause.PART, Cause.UNSURE, Cause.GEL))

    assert together([gel, unsure, part]) is part
    assert together([gel, unsure, gel]) is unsure
    assert together([gel]) is gel
    assert together([]) is None


def test_what_is_left_is_a_share_of_the_place() -> None:
    """Weighted by how far it is above the limit; what the press without marks shows elsewhere does not count, and a
    place cannot become larger."""
    excess = np.zeros((20, 20), np.float32)
    excess[10, 8:18] = 2
    without = np.zeros((20, 20), np.float32)
    without[10, 8:13] = 1
    without[2, 2] = 50

    assert remaining(excess, without) == pytest.approx(0.25)
    assert remaining(excess, excess * np.float32(3)) == 1
    assert remaining(excess, np.zeros_like(excess)) == 0
    assert remaining(np.zeros_like(excess), without) == 1


@pytest.mark.parametrize(
    ("left", "at_least", "cause"),
    [(0.1, 0.0, Cause.GEL), (0.9, 0.1, Cause.UNSURE), (0.3, 0.1, Cause.UNSURE), (0.9, 0.7, Cause.PART)],
)
def test_what_may_be_the_rest_of_the_last_press_makes_nothing_the_gel_s(
    left: float, at_least: float, cause: Cause
) -> None:
    """Nor the part's, where it explains the place."""
    assert blame(doubt(left, at_least), NEVER, 1.0).cause is cause
