"""A picture of the free gel that does not belong to the presses is named, and one that does is not."""

import numpy as np
import pytest
from press_films import PARTS, grains, series

from edge.core.contact.mask import Touch, imprint_strength, squared_distance, touched, touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.contact.relief import ReliefOfReference
from edge.core.contact.tracker import ContactTracker
from edge.core.contact.wear import foreign_free_gel, foreign_start


def other_light(view: View) -> View:
    """A lamp on one side is brighter, by more than a gain and an offset explain."""
    columns, rows = np.linspace(-1, 1, 160, dtype=np.float32), np.linspace(-1, 1, 120, dtype=np.float32)
    lit = 45 * np.clip(columns, 0, 1)[None, :, None] * np.abs(rows)[:, None, None]
    return np.clip(view + lit * np.array([1, 0.3, -0.8], np.float32), 0, 255).astype(np.float32)


def contacts(part: str, free: View) -> tuple[list[Touch], list[float]]:
    reference = Reference(free)
    differences = [reference.difference(view) for view in series(part, "clear")[9:14]]
    structure = ReliefOfReference(free)
    return (
        [touched(touched_mask(difference)) for difference in differences],
        [structure.of(difference, 3.5).area for difference in differences],
    )


def test_a_free_gel_of_another_light_is_named() -> None:
    """The touched area is the light's: many times the relief, and the same for every press."""
    said = foreign_free_gel(*contacts("ball", other_light(series("ball", "clear")[0])))
    assert said is not None
    assert "most likely of another light" in said


def test_a_free_gel_of_the_same_light_is_not() -> None:
    """Whatever the part; two presses are too few to say, and areas that differ are those of the presses."""
    for part in PARTS:
        assert foreign_free_gel(*contacts(part, series(part, "clear")[0])) is None
    assert foreign_free_gel([Touch(0.3)] * 2, [0.01] * 2) is None
    assert foreign_free_gel([Touch(0.3)] * 3, [0.01] * 3) is not None
    assert foreign_free_gel([Touch(0.2), Touch(0.3), Touch(0.4)], [0.01] * 3) is None


def test_a_start_in_another_light_is_named() -> None:
    """The free gel is compared with the one at the fit: the same is silent, another light is said, a part is not."""
    views = series("PZ3", "clear")
    free = Reference(views[0])
    assert foreign_start(free, free) is None
    assert foreign_start(Reference(views[0] * np.float32(0.85)), free) is None
    assert foreign_start(Reference(views[12]), free) is None
    said = foreign_start(Reference(other_light(views[0])), free)
    assert said is not None
    assert "another light" in said


@pytest.mark.parametrize("part", PARTS)
def test_noise_hardly_moves_the_strength_of_a_part_at_rest(part: str) -> None:
    """A press rests where its strength has grown by less than 3 %; of a mask that flickers it moved by up to 13 %."""
    free, *_, pressed = series(part, "clear")[:12]
    reference = Reference(free)
    strengths = [
        imprint_strength(squared_distance(reference.difference(pressed + grain))) for grain in grains()
    ]
    assert np.std(strengths) < 0.01 * np.mean(strengths)


@pytest.mark.parametrize("brightness", [0.7, 1.0, 1.15])
@pytest.mark.parametrize("part", PARTS)
def test_a_press_is_as_strong_in_the_light_of_another_day(part: str, brightness: float) -> None:
    """Strength is told as the bundle's picture of the free gel was lit."""
    free, pressed = series(part, "clear")[[0, 12]]
    tracker = ContactTracker(witness=Reference(free))
    for number in range(60):
        lit = (pressed if number >= 50 else free) * np.float32(brightness)
        tracker.feed(np.clip(lit, 0, 255), number * 40_000_000, number)
    assert tracker.seen is not None
    expected = imprint_strength(squared_distance(Reference(free).difference(pressed)))
    assert tracker.seen.strength == pytest.approx(expected, rel=0.05)
