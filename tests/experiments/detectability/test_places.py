"""The grid of places, and spots in it."""

import numpy as np
import pytest

from calibration.experiments.detectability.study import PlaceGrid, touched_places
from calibration.simulator.field_of_view import Field

GRID = PlaceGrid(Field((96, 48), (0.05, 0.1)), 1.2)


def test_places_divide_the_region_evenly() -> None:
    """A region of 4.8 x 4.8 mm at 1.2 mm has 4 x 4 places of whole pixels; the origin is its middle."""
    assert GRID.shape == (4, 4)
    assert GRID.middle_mm((0, 3)) == pytest.approx((1.8, -1.8))
    covered = np.zeros((48, 96), int)
    for row in range(4):
        for column in range(4):
            covered[GRID.pixels((row, column))] += 1
    assert (covered == 1).all()
    with pytest.raises(ValueError, match="positive"):
        PlaceGrid(GRID.field, 0.0)


def test_a_place_is_of_the_contact_where_half_of_the_presses_touch_it() -> None:
    """Two presses of four touch the upper left place, one touches the lower right."""
    contacts = np.zeros((4, 48, 96), np.bool_)
    contacts[:2, :12, :24] = True
    contacts[3, 36:, 72:] = True
    assert touched_places(GRID, list(contacts)) == ((0, 0),)


def test_spots_are_where_the_press_touches() -> None:
    """Every spot lies on a touched pixel of its place; a place that is hardly touched has none."""
    contact = np.zeros((48, 96), np.bool_)
    contact[0:6, 0:6] = True
    rng = np.random.default_rng(0)
    spots = [GRID.spot(contact, (0, 0), rng) for _ in range(50)]
    for spot in spots:
        assert spot is not None
        row, column = int((spot.y_mm + 2.4) / 0.1), int((spot.x_mm + 2.4) / 0.05)
        assert contact[row, column]
    assert len({spot.turn_rad for spot in spots if spot}) == 50
    assert GRID.spot(contact, (1, 1), rng) is None
