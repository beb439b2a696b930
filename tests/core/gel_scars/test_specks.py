"""Marks of the free gel press after press: when one is said, and when no more."""

import numpy as np
import pytest

from edge.core.gel_scars.specks import Specks


def clear(*at: tuple[int, int]) -> np.ndarray:
    places = np.zeros((120, 160), bool)
    for row, column in at:
        places[row : row + 2, column : column + 2] = True
    return places


@pytest.mark.parametrize(
    ("seen", "said"),
    [("11111", 5), ("1111011111", 8), ("1010101010", None), ("1111100011111", 5)],
    ids=["each time", "but once", "every other time", "gone for three"],
)
def test_a_mark_is_said_that_is_seen_in_five_presses(seen: str, said: int | None) -> None:
    """A time without takes two back, and what is not seen is not said."""
    specks, first = Specks(), None
    for number, is_seen in enumerate(seen, 1):
        specks.see(clear((40, 60)) if is_seen == "1" else clear())
        if specks.lasting.any() and first is None:
            first = number
        assert is_seen == "1" or not specks.lasting.any()

    assert first == said


def test_marks_at_other_places_each_time_are_not_one() -> None:
    specks = Specks()
    for number in range(8):
        specks.see(clear((10 * number, 60), (100, 100 + number % 2)))

    assert np.argwhere(specks.lasting).min(axis=0).tolist() == [100, 101]
    assert specks.lasting.sum() == 4
