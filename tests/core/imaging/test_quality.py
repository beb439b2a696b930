"""Reasons against scoring a press."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.imaging.quality import (
    NominalContact,
    QualitySettings,
    Reason,
    check_contact,
    check_freshness,
    check_light,
    saturated_fraction,
)

NOMINAL = NominalContact(x=(0.47, 0.53), y=(0.42, 0.58), area=(0.05, 0.10))
LR = (320, 240)


def flat(value: int) -> NDArray[np.uint8]:
    return np.full((240, 320, 3), value, np.uint8)


LIT = flat(100)
LIT[:48, :, 2] = 255


@pytest.mark.parametrize(
    ("picture", "free_saturated", "reason"),
    [
        (flat(0), 0.0, Reason.BLACK),
        (flat(78), 0.0, None),
        (flat(255), 0.0, Reason.SATURATED),  # a uint8 sum would wrap
        (LIT, 0.0, Reason.SATURATED),  # one channel is enough
        (LIT, 0.15, None),  # what is saturated on the free gel does not count
    ],
)
def test_light(picture: NDArray[np.uint8], free_saturated: float, reason: Reason | None) -> None:
    """A dark sensor, a dim picture and too much light are distinguished."""
    found = check_light(picture, free_saturated=free_saturated)
    assert (found and found.reason) is reason


def test_the_saturated_share_is_that_of_pixels() -> None:
    """A fifth of the rows, in one channel."""
    assert saturated_fraction(LIT) == pytest.approx(0.2)


@pytest.mark.parametrize(("age_ns", "is_stale"), [(0, False), (10**9, False), (10**9 + 1, True), (-1, True)])
def test_stale_frames(age_ns: int, is_stale: bool) -> None:
    """Older than a second is stale, and so is a frame from the future."""
    found = check_freshness(5 * 10**9, 5 * 10**9 + age_ns)
    assert (found is not None) == is_stale
    assert found is None or found.reason is Reason.STALE


@pytest.mark.parametrize(
    ("touch", "reason", "word"),
    [
        (Touch(0.07, 0.5, 0.5), None, ""),
        (None, Reason.NO_CONTACT, ""),
        (Touch(0.0), Reason.NO_CONTACT, ""),
        (Touch(0.07, 0.4, 0.5), Reason.OFF_POSITION, "column"),
        (Touch(0.07, 0.5, 0.7), Reason.OFF_POSITION, "row"),
        (Touch(0.04, 0.5, 0.5), Reason.OFF_POSITION, "area"),
        (Touch(0.11, 0.5, 0.5), Reason.OFF_POSITION, "area"),
        (Touch(0.10, 0.53, 0.42), None, ""),  # a limit belongs to the range
        (Touch(0.07, 0.4, 0.5), Reason.OFF_POSITION, "128 px, nominal presses have 150 to 170 px"),
    ],
)
def test_no_contact_and_off_position(touch: Touch | None, reason: Reason | None, word: str) -> None:
    """Column, row and area are each compared with the nominal range, and named."""
    found = check_contact(touch, NOMINAL, LR)
    assert (found and found.reason) is reason
    assert found is None or word in found.text


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: NominalContact((2, 1), (0, 1), (0, 1)), "x runs"),
        (lambda: QualitySettings(black_level=251), "black_level"),
        (lambda: QualitySettings(max_age_s=0), "max_age_s"),
    ],
)
def test_nonsense_is_refused(make: Callable[[], object], name: str) -> None:
    """Ranges are ascending, and limits are valid levels."""
    with pytest.raises(ValueError, match=name):
        make()
