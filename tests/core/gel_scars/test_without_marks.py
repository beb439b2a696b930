"""The picture without the marks: what is taken out, and where."""

import numpy as np
import pytest

from edge.core.gel_scars.press import without_marks
from edge.core.imaging.region import Region


@pytest.mark.parametrize("size", [(160, 120), (320, 240), (1280, 720), (3280, 2464)])
def test_a_change_of_the_view_is_taken_out_where_it_is_in_the_picture(size: tuple[int, int]) -> None:
    """Of pictures of any size, in the inspected region alone; what is far from it stays as it is."""
    change = np.zeros((120, 160, 3), np.float32)
    change[50:60, 70:90] = (20, -10, 5)
    region = Region(size[0] // 4, size[1] // 4, size[0] // 2, size[1] // 2)
    found = without_marks(np.full((region.height, region.width, 3), 100, np.uint8), change, size, region)
    x, y = (int((at + 0.5) * size[k] / (160, 120)[k]) for k, at in enumerate((80, 55)))

    assert found.dtype == np.uint8
    assert found[y - region.y, x - region.x].tolist() == [80, 110, 95]
    assert (found[:3] == 100).all()
    share = (found != 100).any(axis=2).mean()
    assert share == pytest.approx(20 * 10 / (80 * 60), rel=0.6)


def test_levels_stay_within_a_picture() -> None:
    """No colour wraps round."""
    rgb = np.array([[[0, 255, 128]]], np.uint8).repeat(120, axis=0).repeat(160, axis=1)
    change = np.broadcast_to(np.array([40, -40, 0], np.float32), (120, 160, 3))

    assert without_marks(rgb, change, (160, 120), Region.full((160, 120)))[60, 80].tolist() == [0, 255, 128]


def test_taking_a_change_out_of_its_own_picture_gives_the_first_one() -> None:
    """To the rounding of the levels, of a smooth change."""
    y, x = np.mgrid[:120, :160]
    change = (
        (30 * np.exp(-((x - 80) ** 2 + (y - 60) ** 2) / 20))[..., None].repeat(3, axis=2).astype(np.float32)
    )
    rgb = np.asarray(np.rint(120 + change), np.uint8)

    found = without_marks(rgb, change, (160, 120), Region.full((160, 120)))
    assert np.abs(found.astype(int) - 120).max() <= 1
