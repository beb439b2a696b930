"""The free gel between presses: which views it is the mean of."""

import numpy as np

from edge.core.contact.table import State
from edge.core.gel_scars.free_change import FreeViews


def view(level: float) -> np.ndarray:
    return np.full((6, 8, 3), level, np.float32)


def seen(*steps: tuple[State, float]) -> FreeViews:
    free = FreeViews()
    for state, level in steps:
        free.see(state, view(level))
    return free


FREE = (State.NO_CONTACT, 10.0)
PRESSED = (State.SETTLING, 90.0)


def mean(free: FreeViews) -> float | None:
    found = free.mean()
    return None if found is None else float(found.mean())


def test_three_views_are_the_least_and_the_last_two_wait() -> None:
    """They may show the approach of the next part."""
    assert mean(seen(*[FREE] * 4)) is None
    assert mean(seen(*[FREE] * 5)) == 10
    assert mean(seen(*[FREE] * 5, (State.NO_CONTACT, 50.0), (State.APPROACH, 60.0), PRESSED)) == 10


def test_a_press_begins_a_new_mean() -> None:
    """Of the press before nothing is left; until the gel is free again the old mean is there for the verdict."""
    before = seen(*[FREE] * 5, PRESSED)
    after = seen(*[FREE] * 5, PRESSED, *[(State.RECOVERY, 20.0)] * 5)

    assert mean(before) == 10
    assert mean(after) == 20
    assert mean(seen(*[FREE] * 5, PRESSED, (State.RECOVERY, 20.0))) is None


def test_the_last_views_count_most() -> None:
    """What a press has left fades meanwhile."""
    found = mean(seen(*[(State.RECOVERY, 30.0)] * 3, *[(State.NO_CONTACT, 10.0)] * 60))

    assert found is not None
    assert 10 < found < 10.5


def test_it_is_forgotten_with_the_gel() -> None:
    """And a station that learns its gel has none."""
    free = seen(*[FREE] * 5)
    free.clear()

    assert free.mean() is None
    assert mean(seen(*[(State.BASELINE, 10.0)] * 9)) is None
