"""Frames as differences to the free gel: grey without contact, cut where the frame was cut."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.benchmark.idea_inputs import of_differences
from calibration.benchmark.trial import Trial
from calibration.fitting.nominal_presses import NominalPresses
from edge.core.errors import DatasetError

GEL = np.broadcast_to(np.linspace(60, 180, 64)[None, :, None], (64, 64, 3)).astype(np.uint8)


def trial() -> Trial:
    """Two presses to learn and three to score, each the free gel with a square that is 40 levels brighter."""
    pressed = GEL.copy()
    pressed[20:30, 20:30] += 40
    learnt, scored = np.stack([pressed] * 2), np.stack([pressed] * 3)
    nominal = NominalPresses(learnt, ("a", "b"), no_contact=GEL[None])
    return Trial("square", nominal, scored, np.zeros((3, 64, 64), np.bool_), np.zeros(3, np.bool_))


def test_a_difference_is_grey_but_for_the_contact() -> None:
    """128 away from the square, 168 in it, in learnt and scored frames."""
    found = of_differences(trial())

    for frames in (found.nominal.frames, found.frames):
        inner = frames[:, 8:-8, 8:-8].astype(int)
        assert abs(np.median(inner) - 128) <= 1
        assert abs(np.median(frames[:, 20:30, 20:30].astype(int)) - 168) <= 2
    assert found.nominal.frames.dtype == found.frames.dtype == np.uint8


def test_each_frame_is_compared_with_the_gel_where_it_was_cut() -> None:
    """A frame whose own free gel is 20 levels brighter is 20 levels darker in the difference."""
    given = trial()
    own = np.stack([GEL, GEL + 20, GEL])
    found = of_differences(replace(given, scored_free=own, learnt_free=own[:2]))

    for frames in (found.frames, found.nominal.frames):
        assert np.median(frames[1].astype(int) - frames[0]) == -20
    assert np.array_equal(found.frames[0], found.frames[2])


def test_presses_without_a_free_gel_are_refused() -> None:
    """The sentence says what to record."""
    given = trial()
    with pytest.raises(DatasetError, match="square: no free gel to take a difference to; record it"):
        of_differences(replace(given, nominal=replace(given.nominal, no_contact=None)))
