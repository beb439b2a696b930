"""Reasons against scoring a press."""

import numpy as np
import pytest

from edge.core.contact.mask import Touch
from edge.core.imaging.frames import Picture
from edge.core.imaging.quality import (
    NominalContact,
    QualitySettings,
    Reason,
    check_contact,
    check_freshness,
    check_light,
    saturated_fraction,
)

NOMINAL = NominalContact(x_px=(150, 170), y_px=(100, 140), area=(0.05, 0.10))
LR = (320, 240)


def flat(value: int) -> Picture:
    return Picture(np.full((240, 320, 3), value, np.uint8), 0, 0)


def test_black_and_ordinary_frames() -> None:
    """A dark sensor and a dim picture are distinguished."""
    black = check_light(flat(0))
    assert black is not None
    assert black.reason is Reason.BLACK
    assert "0.0" in black.text
    assert check_light(flat(78)) is None


def test_saturation_counts_beyond_the_free_gel() -> None:
    """One channel at 255 is enough; pixels that are saturated on the free gel do not count."""
    rgb = np.full((240, 320, 3), 100, np.uint8)
    rgb[:48, :, 2] = 255
    assert saturated_fraction(rgb) == pytest.approx(0.2)
    found = check_light(Picture(rgb, 0, 0))
    assert found is not None
    assert found.reason is Reason.SATURATED
    assert check_light(Picture(rgb, 0, 0), free_saturated=0.15) is None


def test_full_scale_frames_do_not_wrap() -> None:
    """255 in every uint8 channel has the mean 255, not what a wrapped sum leaves."""
    found = check_light(flat(255))
    assert found is not None
    assert found.reason is Reason.SATURATED


@pytest.mark.parametrize(("age_ns", "is_stale"), [(0, False), (10**9, False), (10**9 + 1, True), (-1, True)])
def test_stale_frames(age_ns: int, is_stale: bool) -> None:
    """Older than a second is stale, and so is a frame from the future."""
    found = check_freshness(5 * 10**9, 5 * 10**9 + age_ns)
    assert (found is not None) == is_stale
    assert found is None or found.reason is Reason.STALE


def test_no_contact_and_off_position() -> None:
    """Column, row and area are each compared with the nominal range, and named."""
    assert check_contact(Touch(0.07, 0.5, 0.5), NOMINAL, LR) is None
    for touch in (None, Touch(0.0)):
        found = check_contact(touch, NOMINAL, LR)
        assert found is not None
        assert found.reason is Reason.NO_CONTACT
    for touch, word in (
        (Touch(0.07, 0.4, 0.5), "column"),
        (Touch(0.07, 0.5, 0.7), "row"),
        (Touch(0.04, 0.5, 0.5), "area"),
        (Touch(0.11, 0.5, 0.5), "area"),
    ):
        found = check_contact(touch, NOMINAL, LR)
        assert found is not None
        assert found.reason is Reason.OFF_POSITION
        assert word in found.text


def test_nonsense_is_refused() -> None:
    """Ranges are ascending, and limits are valid levels."""
    with pytest.raises(ValueError, match="x_px"):
        NominalContact((2, 1), (0, 1), (0, 1))
    with pytest.raises(ValueError, match="black_level"):
        QualitySettings(black_level=251)
    with pytest.raises(ValueError, match="max_age_s"):
        QualitySettings(max_age_s=0)
