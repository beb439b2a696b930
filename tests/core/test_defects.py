"""Where a defect lies, on maps whose answer is known."""

import numpy as np
import pytest

from edge.core.defects import Defect, find_defects
from edge.core.imaging.known_profiles import profile
from edge.messaging.result_payload import DefectPlace


def test_a_map_below_the_threshold_has_no_defect() -> None:
    """At the threshold is not above it."""
    assert find_defects(np.full((8, 8), 1.0, np.float32), 1.0) == []


def test_a_rectangle_is_found_with_its_box_centre_and_area() -> None:
    """Columns 2 to 4 and rows 1 to 2: box (2, 1, 3, 2), centre (3.5, 2.0) from the corner, six pixels."""
    scores = np.zeros((6, 8), np.float32)
    scores[1:3, 2:5] = 2.0
    scores[2, 3] = 5.0

    (defect,) = find_defects(scores, 1.0)

    assert defect.box_px == (2, 1, 3, 2)
    assert defect.centroid_px == (3.5, 2.0)
    assert defect.area_px == 6
    assert defect.score == 5.0


def test_the_strongest_part_comes_first_and_diagonals_are_one_part() -> None:
    """Two parts, the smaller one scores higher; the larger one hangs together by a corner."""
    scores = np.zeros((10, 10), np.float32)
    scores[0:2, 0:2] = 2.0
    scores[2:4, 2:4] = 2.0
    scores[8, 8] = 9.0

    found = find_defects(scores, 1.0)

    assert [(defect.score, defect.area_px) for defect in found] == [(9.0, 1), (2.0, 8)]


@pytest.mark.parametrize(
    ("name", "x_mm", "y_mm"),
    [
        ("cropped_lr", 0.0634, 0.0634),
        ("mini_lr", 0.0634, 0.0634 * (2464 / 240) / (3280 / 320)),
        ("mini_hr", 0.01585, 0.01585 * (2464 / 720) / (3280 / 1280)),
        ("mini_hr43", 0.01585, 0.01585 * (2464 / 960) / (3280 / 1280)),
    ],
)
def test_a_pixel_has_its_size_along_both_axes(name: str, x_mm: float, y_mm: float) -> None:
    """A profile that squeezes the rows has taller pixels: 4/3 at 1280x720."""
    assert profile(name).mm_per_pixel == pytest.approx((x_mm, y_mm))


def test_a_defect_is_placed_in_millimetres_along_both_axes() -> None:
    """Worked by hand, for pixels that are twice as tall as wide."""
    place = DefectPlace.of(Defect((2, 1, 3, 2), (3.5, 2.0), 6, 5.0, np.ones((2, 3), bool)), 0.1, 0.2)
    assert place.size_px == 3.2  # from corner to corner, sqrt(2**2 + 1) and a pixel
    assert (place.box_mm, place.centroid_mm, place.area_mm2) == ((0.2, 0.2, 0.3, 0.4), (0.35, 0.4), 0.12)
