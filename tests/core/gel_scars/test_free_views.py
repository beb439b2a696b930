"""The free gel between presses: which views it is the mean of."""

import numpy as np
import pytest

from edge.core.contact.table import State
from edge.core.gel_scars.free_change import FreeViews


def view(level: float) -> np.ndarray:
    return np.full((6, 8, 3), level, np.float32)


def seen(*steps: tuple[State, float], interval_s: float = 0.1, faint: int | None = None) -> FreeViews:
    """Feed views. faint: the number of one in which something may touch."""
    free = FreeViews()
    for number, (state, level) in enumerate(steps):
        free.see(state, view(level), round(number * interval_s * 1e9), is_faint=number == faint)
    return free


FREE = (State.NO_CONTACT, 10.0)
PRESSED = (State.SETTLING, 90.0)


def mean(free: FreeViews) -> float | None:
    found = free.mean()
    return None if found is None else float(found.mean())


def test_views_just_before_a_press_are_held_back() -> None:
    """They may show the approach of the next part: at 10 and at 18.75 frames a second, and where every look of an idle
    gel is. Two others are of a moment, three of no moment."""
    pressed = (State.APPROACH, 60.0), PRESSED
    for interval_s, least in ((0.1, 2), (4 / 75, 4), (0.15, 2)):
        found = [mean(seen(*[FREE] * number, *pressed, interval_s=interval_s)) for number in range(6)]
        assert found == [None] * least + [10] * (6 - least)
        fresh = [seen(*[FREE] * number, *pressed, interval_s=interval_s).is_fresh for number in range(8)]
        assert fresh == [True] * (least + 2) + [False] * (6 - least)
        late = *[FREE] * least, (State.NO_CONTACT, 50.0), *pressed
        assert mean(seen(*late, interval_s=interval_s)) == 10


def test_a_view_in_which_something_may_touch_is_no_picture_of_the_free_gel() -> None:
    """Nor is what came just before; what was seen well before counts on."""
    views = *[FREE] * 2, (State.NO_CONTACT, 50.0), *[FREE] * 3

    assert mean(seen(*views, faint=2)) == 10
    assert mean(seen(*views)) == pytest.approx((10 + 10 + 50 + 10) / 4)


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
