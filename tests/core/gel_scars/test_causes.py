"""Gel or part: the rules, each with the case that it is for."""

import numpy as np
import pytest

from edge.core.gel_scars.causes import Blame, Cause, blame, explained, together
from edge.core.gel_scars.record import Repeats

NEVER = Repeats()
FIXTURE = Repeats(hits=3.5, rate=1.0, spread_mm=0.1)
"""In each of the last presses, with the part at one place."""


@pytest.mark.parametrize(
    ("share", "repeats", "wide_mm", "cause"),
    [
        (1.0, NEVER, 1.0, Cause.GEL),  # the free gel shows it
        (0.8, NEVER, 1.0, Cause.GEL),
        (0.75, NEVER, 1.0, Cause.UNSURE),  # the free gel shows a part of it
        (0.5, FIXTURE, 1.0, Cause.GEL),  # half of it, and it came back
        (0.5, Repeats(2.0, 1.0, 0.1), 1.0, Cause.UNSURE),
        (0.4, FIXTURE, 1.0, Cause.UNSURE),
        (0.2, NEVER, 1.0, Cause.PART),
        (0.0, NEVER, 1.0, Cause.PART),
        (None, NEVER, 1.0, Cause.UNSURE),  # the free gel was not seen
        (0.0, FIXTURE, 1.0, Cause.PART),  # pieces damaged at one place in a fixture: the free gel decides
        (None, FIXTURE, 1.0, Cause.UNSURE),
        (0.0, Repeats(6.0, 1.0, 0.1), 1.0, Cause.UNSURE),  # so often that a tool or the gel is likely
        (0.0, Repeats(6.0, 0.3, 0.1), 1.0, Cause.PART),  # often, and mostly not
        (0.0, Repeats(3.0, 1.0, 1.4), 1.0, Cause.GEL),  # the part moved, the place did not
        (None, Repeats(3.0, 1.0, 1.4), 1.0, Cause.GEL),
        (0.0, Repeats(3.0, 1.0, 1.4), 2.0, Cause.PART),  # a place as wide as the movement
        (0.0, Repeats(2.0, 1.0, 1.4), 1.0, Cause.PART),  # twice is not yet a rule
        (0.0, Repeats(3.0, 0.4, 1.4), 1.0, Cause.PART),  # most presses are quiet there
    ],
)
def test_each_rule(share: float | None, repeats: Repeats, wide_mm: float, cause: Cause) -> None:
    """As docs/gel-scars.md says, with a sentence why."""
    found = blame(share, repeats, wide_mm)

    assert found.cause is cause
    assert len(found.why.split()) >= 6


def test_damage_counts_before_doubt_and_doubt_before_the_gel() -> None:
    """A press with a scar and damage is a damaged part."""
    part, unsure, gel = (Blame(cause, "why") for cause in (Cause.PART, Cause.UNSURE, Cause.GEL))

    assert together([gel, unsure, part]) is part
    assert together([gel, unsure, gel]) is unsure
    assert together([gel]) is gel
    assert together([]) is None


def test_a_mark_explains_what_is_near_it() -> None:
    """Two pixels away still, three not: 0.25 mm."""
    excess = np.zeros((20, 20), np.float32)
    excess[10, 8:18] = 1
    marked = np.zeros((20, 20), bool)
    marked[10, 8:11] = True
    nothing = np.zeros((20, 20), bool)

    assert explained(excess, marked, nothing) == pytest.approx(0.5)
    assert explained(excess, nothing, marked) == pytest.approx(0.4)  # the rim of a mask is the next pixel
    assert explained(excess, nothing, nothing) == 0
    assert explained(np.zeros((20, 20), np.float32), marked, nothing) == 0


def test_a_high_peak_weighs_more_than_a_wide_rim() -> None:
    """What is just above the limit around damage decides nothing."""
    excess = np.full((20, 20), 0.01, np.float32)
    excess[3, 3] = 50
    marked = np.zeros((20, 20), bool)
    marked[10:, 10:] = True

    assert explained(excess, marked, np.zeros((20, 20), bool)) < 0.1


def test_a_speck_does_not_explain_a_wide_place() -> None:
    """A mark of less than a quarter of the place is there by chance."""
    excess = np.zeros((20, 20), np.float32)
    excess[9:12, 9:12] = 1
    speck, mark = np.zeros((2, 20, 20), bool)
    speck[10, 9:11] = True
    mark[10, 9:12] = True
    nothing = np.zeros((20, 20), bool)

    assert explained(excess, speck, nothing) == 0
    assert explained(excess, mark, nothing) == 1
