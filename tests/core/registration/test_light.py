"""What a press adds to the free gel's light."""

import numpy as np
import pytest
import turned_parts as parts

from edge.core.registration.colours import FreeLight
from edge.core.registration.pose import Pose


def test_a_part_shows_the_same_in_the_corner_as_in_the_middle() -> None:
    """The light is a tenth weaker in the corner; what the part adds is divided by it."""
    light = FreeLight(parts.free_gel())
    middle, corner = (
        float(np.abs(light.find_change(parts.press(parts.BALL, Pose(x, x), noise=0))).max())
        for x in (0.0, 42.0)
    )

    assert 0.95 < corner / middle < 1.05


def test_what_is_added_gives_the_press_again() -> None:
    """To the level of a picture."""
    light, press = FreeLight(parts.free_gel()), parts.press(parts.BLOCK, Pose(3.0, 4.0, 1.0))
    again = light.picture(light.find_change(press)).astype(np.float64)

    assert float(np.abs(again - press).mean()) < 0.6


def test_a_change_is_shown_by_its_weight() -> None:
    """Without weight the picture stays, with all of it it is that of the sum, and between it lies between."""
    light = FreeLight(parts.free_gel())
    part = light.find_change(parts.press(parts.BLOCK, noise=0))
    other = light.find_change(parts.press(parts.OTHER, noise=0))
    change, ones = other - part, np.ones(part.shape[:2], np.float32)
    none, half, all_of_it = (
        light.apply_change(light.levels(part), change, ones * share) for share in (0.0, 0.5, 1.0)
    )

    for found, expected in ((none, part), (half, (part + other) / 2), (all_of_it, other)):
        assert np.abs(found.astype(np.int16) - light.picture(expected)).max() <= 1


def test_a_region_smaller_than_the_picture_of_the_level_shows_what_is_added() -> None:
    free = np.full((60, 60, 3), 120, np.uint8)
    press = free.copy()
    press[20:30, 20:30] += 30
    added = FreeLight(free).find_change(press)
    assert added[25, 25] == pytest.approx(30, abs=3)
    assert added[5, 5] == pytest.approx(0, abs=1)
