"""Light and soft contact: relief finds it before an area has changed, and finds nothing where nothing presses."""

import numpy as np
import pytest
from press_films import DEPTHS, NOISE_SD, series

from edge.core.contact.mask import touched, touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.contact.relief import ReliefOfReference, with_relief
from edge.core.contact.settings import ContactSettings

LEVELS = ContactSettings().light_levels
ON = ContactSettings().on_area


def noisy(view: View, seed: int) -> View:
    noise = np.random.default_rng(seed).normal(0, NOISE_SD, view.shape)
    return np.clip(np.rint(view + noise), 0, 255).astype(np.float32)


def first_depth(part: str, *, by_relief: bool) -> float:
    """The depth at which a part counts as contact, as a share of its full depth; 2 where it never does."""
    views = series(part, "clear")
    reference = Reference(np.mean([noisy(views[0], k) for k in range(10)], axis=0, dtype=np.float32))
    structure = ReliefOfReference(reference.view)
    for depth, view in zip(DEPTHS, views, strict=True):
        difference = reference.difference(noisy(view, 99))
        found = structure.of(difference, LEVELS).area if by_relief else touched(touched_mask(difference)).area
        if found >= ON:
            return depth
    return 2.0


@pytest.mark.parametrize("part", ["soft", "PZ1", "ball"])
def test_relief_finds_a_contact_no_later_than_area(part: str) -> None:
    """And a soft, textured part at half the depth."""
    assert first_depth(part, by_relief=True) <= first_depth(part, by_relief=False)
    if part == "soft":
        assert first_depth(part, by_relief=True) <= first_depth(part, by_relief=False) / 2


@pytest.mark.parametrize("gel", ["clear", "marker"])
@pytest.mark.parametrize("gain", [0.8, 1.0, 1.15])
def test_the_free_gel_has_no_relief(gel: str, gain: float) -> None:
    """Noise and a change of exposure, on a gel with dust, scratches and markers: far below a contact."""
    view = series("PZ1", gel)[0]
    reference = Reference(np.mean([noisy(view, k) for k in range(10)], axis=0, dtype=np.float32))
    structure = ReliefOfReference(reference.view)
    for seed in range(20):
        difference = reference.difference(noisy(view * np.float32(gain), 50 + seed))
        assert structure.of(difference, LEVELS).area < ON / 4


def test_noise_is_no_relief() -> None:
    """Five times the usual noise of a sensor: the bound rises with what the quietest view shows."""
    rng = np.random.default_rng(0)
    structure = ReliefOfReference(np.full((120, 160, 3), 120, np.float32))
    for _ in range(10):
        difference = rng.normal(0, 5 * NOISE_SD, (120, 160, 3)).astype(np.float32)
        assert structure.of(difference, LEVELS).area < ON / 4


def test_relief_places_a_contact_that_has_no_area() -> None:
    """And leaves one alone that has."""
    structure = ReliefOfReference(np.full((120, 160, 3), 120, np.float32))
    rows, columns = np.mgrid[:120, :160]
    difference = np.zeros((120, 160, 3), np.float32)
    difference[(rows - 40) ** 2 + (columns - 120) ** 2 < 15**2] = 8
    difference[(rows // 4 + columns // 4) % 2 == 0] *= -1
    relief = structure.of(difference, LEVELS)
    seen = touched(with_relief(touched_mask(difference), relief, ON))
    assert seen.area >= ON
    assert (seen.x * 160, seen.y * 120) == pytest.approx((120, 40), abs=2)
    large = np.zeros((120, 160), np.bool_)
    large[:30] = True
    assert with_relief(large, relief, ON) is large


def test_a_press_adds_structure_and_a_lift_takes_it_away() -> None:
    """The sign by which a reference that was learnt pressed is known."""
    free, pressed = (noisy(view, 1) for view in series("PZ3", "clear")[[0, 12]])
    for seen, learnt, sign in ((pressed, free, 1), (free, pressed, -1)):
        difference = Reference(learnt).difference(seen)
        gain = ReliefOfReference(learnt).of(difference, LEVELS).gain(touched_mask(difference))
        assert sign * gain > 0.7


def test_a_view_without_a_contact_has_no_sign() -> None:
    """Neither touched nor structured: it adds nothing and takes nothing away."""
    view = np.full((120, 160, 3), 120, np.float32)
    nothing = ReliefOfReference(view).of(np.zeros_like(view), LEVELS)

    assert nothing.gain(np.zeros((120, 160), np.bool_)) == 0
