"""Which contacts a bundle accepts, from those of its nominal presses."""

import pytest
from tiny_fit import config, presses

from calibration.fitting.bundle_measurements import contact_range
from calibration.fitting.fit import fit_files
from edge.core.contact.mask import Touch


def test_the_contact_area_is_not_open_below() -> None:
    """Nominal contacts of 4 to 30 %: one of 1.9 % is refused, although the span is wide."""
    touches = tuple(Touch(area) for area in (0.04, 0.3, 0.2))
    found = contact_range(presses(3, touches=touches))
    assert found is not None
    assert found.area == pytest.approx((0.02, 0.43))


def test_contact_range_holds_the_nominal_presses_and_not_one_far_away() -> None:
    """Off-position presses are detected by centroid and area."""
    touches = tuple(Touch(0.10 + 0.01 * k, 0.50 + 0.01 * k, 0.40) for k in range(4))
    contact = fit_files(presses(4, touches=touches), config(), created="").manifest.contact
    assert contact is not None

    def holds(touch: Touch) -> bool:
        return all(low <= getattr(touch, name) <= high for name, (low, high) in vars(contact).items())

    assert all(holds(touch) for touch in touches)
    assert holds(Touch(0.12, 0.55, 0.42))
    assert not holds(Touch(0.12, 0.80, 0.40))
    assert not holds(Touch(0.50, 0.50, 0.40))
