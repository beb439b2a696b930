"""Reasons against scoring a press."""

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.imaging.quality import (
    NominalContact,
    Reason,
    check_contact,
    check_freshness,
    check_light,
)

NOMINAL = NominalContact(x=(0.47, 0.53), y=(0.42, 0.58), area=(0.05, 0.10))
LR = (320, 240)


def flat(value: int) -> NDArray[np.uint8]:
    return np.full((240, 320, 3), value, np.uint8)


LIT, GLARING = flat(100), flat(100)
LIT[:24, :, 2] = 255
GLARING[:25, :, 2] = 250


@pytest.mark.parametrize(
    ("picture", "reason"),
    [
        (flat(7), Reason.BLACK),
        (flat(8), None),
        (flat(78), None),
        (flat(255), Reason.SATURATED),  # a uint8 sum would wrap
        (GLARING, Reason.SATURATED),  # one channel is enough
        (LIT, None),  # a tenth of the rows
    ],
)
def test_light(picture: NDArray[np.uint8], reason: Reason | None) -> None:
    for colour in range(3):  # whichever it is
        found = check_light(np.roll(picture, colour, axis=2))
        assert (found and found.reason) is reason
        assert found is None or "10% of the frame" not in found.text  # at most 10 % is accepted


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
    found = check_contact(touch, NOMINAL, LR)
    assert (found and found.reason) is reason
    assert found is None or word in found.text


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="x runs from low to high"):
        NominalContact((2, 1), (0, 1), (0, 1))
