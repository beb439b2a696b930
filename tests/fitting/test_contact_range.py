"""Which contacts a bundle accepts, from those of its nominal presses."""

from pathlib import Path

import pytest
from station import press_recording, small_bundle
from tiny_fit import config, presses

from calibration.fitting.bundle_measurements import contact_range, strength_range
from calibration.fitting.fit import fit_files
from edge.core.contact.events import PressSettled
from edge.core.contact.mask import Touch
from edge.core.contact.press_detector import PressDetector
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.quality import NominalStrength
from edge.model.bundle import Bundle
from edge.recording.format import Recording


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


@pytest.mark.parametrize(
    ("strengths", "found"),
    [
        ((2.0, 3.5, 3.0, 2.5), NominalStrength(2.0, 2.75, 3.5)),
        ((), None),
        ((2.0, 0.0, 3.0, 2.5), None),
    ],
    ids=["known", "the free gel was not seen", "one too light to have a strength"],
)
def test_strength_of_nominal_presses(strengths: tuple[float, ...], found: NominalStrength | None) -> None:
    assert strength_range(presses(4, strengths=strengths)) == found


def test_a_bundle_knows_how_strong_the_gateway_sees_its_presses(tmp_path: Path) -> None:
    """From the same recording; the gateway decodes its small views from fewer pixels."""
    recorded = press_recording(tmp_path / "pressed", 4)
    strength = Bundle.load(small_bundle(tmp_path / "bundle", recorded)).manifest.strength
    assert strength is not None
    detector = PressDetector(profile("cropped_lr"))
    seen = [
        event.strength
        for shown in Recording.open(recorded)
        for event in detector.feed(shown.frame).events
        if isinstance(event, PressSettled)
    ]
    assert [strength.lowest, strength.highest] == pytest.approx([min(seen), max(seen)], rel=0.1)
