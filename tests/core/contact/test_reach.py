"""Where the part is or should be: a burr is the part's, a speck that nothing presses is the gel's."""

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.contact.relief import (
    ReliefOfReference,
    find_contact,
    find_expected_reach,
    reach,
    reach_beside_marks,
)
from edge.core.imaging.region import Region

GEL = np.full((120, 160, 3), 120, np.float32)
# Columns, rows and levels of a part in the view.
PART = ((60, 100), (40, 80), 40.0)


def pressed(*patches: tuple[tuple[int, int], tuple[int, int], float], noise: int = 1) -> View:
    """The gel with these patches, and noise."""
    view = GEL + np.random.default_rng(noise).normal(0, 1, GEL.shape).astype(np.float32)
    for (left, right), (top, bottom), levels in patches:
        view[top:bottom, left:right] += np.float32(levels)
    return np.asarray(view, np.float32)


def reached(*patches: tuple[tuple[int, int], tuple[int, int], float]) -> NDArray[np.bool_]:
    gel = Reference(GEL)
    added = gel.difference(pressed(*patches))
    return reach(touched_mask(added), ReliefOfReference(GEL).of(added, 3.5))


def test_the_part_is_reached_and_half_a_millimetre_around() -> None:
    """And not 1.3 mm beside it."""
    found = reached(PART)

    assert found[40:80, 56:104].all()
    assert not found[:, 114:].any()


def test_a_burr_of_a_quarter_millimetre_is_the_part_s_and_a_faint_speck_is_not() -> None:
    """The speck of 0.4 mm changes the gel by 5 levels, as dust does; the burr by 40, as what is pressed does."""
    burr, speck = ((129, 131), (20, 22), 40.0), ((129, 132), (20, 23), 5.0)

    assert reached(PART, burr)[21, 130]
    assert not reached(PART, speck)[10:32, 120:].any()


def test_a_strong_speck_of_the_gel_is_not_the_part_s_and_a_burr_on_it_is() -> None:
    """By what the press adds to the gel as it was just before; away from marks of the gel nothing changes."""
    speck, burr = ((128, 132), (20, 24), 40.0), ((129, 131), (21, 23), 40.0)
    free, near = pressed(speck, noise=2), np.zeros((120, 160), bool)
    near[10:34, 118:142] = True

    def reached_beside(*patches: tuple[tuple[int, int], tuple[int, int], float]) -> NDArray[np.bool_]:
        level = pressed(*patches)
        relief = ReliefOfReference(GEL).of(level - GEL, 3.5)
        return reach_beside_marks(touched_mask(level - GEL), relief, level, free, near)

    assert reached(PART, speck)[21, 130]
    assert not reached_beside(PART, speck)[near].any()
    assert reached_beside(PART, speck, burr)[21, 130]
    assert reached_beside(PART, speck)[40:80, 56:104].all()


def test_nominal_presses_show_where_relief_is_expected() -> None:
    """A pin far from the rest of the part; places are those of the region."""
    view = pressed(PART, ((130, 134), (20, 24), 40.0))
    picture = np.clip(cv2.resize(view, (320, 240)), 0, 255).astype(np.uint8)
    region = Region.centre((320, 240))
    expected = find_expected_reach(
        [np.ascontiguousarray(region.crop(picture))], GEL.astype(np.uint8), None, region, (320, 240)
    )

    assert expected is not None
    assert expected[44 - region.y, 264 - region.x]
    assert expected[120 - region.y, 160 - region.x]
    assert not expected[150:, 180:].any()


def test_the_usual_contact_shows_it_too() -> None:
    """Where half of the nominal presses touch; of a bundle that shows neither nothing is known."""
    usual = np.zeros((4, 4), np.float32)
    usual[1, 2], usual[3, 3] = 1.0, 0.3
    region = Region(0, 0, 8, 8)
    expected = find_expected_reach([], None, usual, region, (8, 8))

    assert expected is not None
    assert np.argwhere(expected).min(axis=0).tolist() == [2, 4]
    assert np.count_nonzero(expected) == 4
    assert find_expected_reach([], None, None, region, (8, 8)) is None


def test_a_press_too_light_for_an_area_has_contact_where_its_relief_is() -> None:
    """A burr alone: no area of the view changes, and only what the burr bends is contact."""
    free = np.full((240, 320, 3), 120, np.uint8)
    press = free.copy()
    press[40:44, 258:262] += 40
    found = find_contact(press, free, (320, 240))
    assert found[40:44, 258:262].all()
    assert not found[:, :220].any()
