"""The gel: above the part, relaxed around it, slow to recover, and the same at every resolution."""

import cv2
import numpy as np
import pytest

from calibration.simulator.field_of_view import HR, LR, Field, grids, native_field
from calibration.simulator.gel import deformation, residual_imprint
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import Pose, contact, sample


def imprint(field: Field, part: str = "PZ5") -> np.ndarray:
    sound = next(iter(PARTS[part].positions.values()))
    return deformation(contact(sample(sound, Pose(), field), PARTS[part].depth_mm), field)


def test_no_part_leaves_the_gel_flat() -> None:
    """An empty obstacle gives a flat surface, in a new array."""
    flat = np.zeros(LR.shape, np.float32)
    surface = deformation(flat, LR)
    assert surface is not flat
    assert not surface.any()


def test_the_gel_never_sinks_into_a_flat_part_nor_above_it() -> None:
    """Over a plateau the surface is the plateau, to within a micrometre away from its edge."""
    x, y = grids(LR)
    plate = np.where((np.abs(x) < 4) & (np.abs(y) < 3), np.float32(0.4), np.float32(0))
    surface = deformation(plate, LR)
    inner = (np.abs(x) < 3.5) & (np.abs(y) < 2.5)
    assert np.abs(surface[inner] - 0.4).max() < 1e-3
    assert surface.max() < 0.401
    assert surface.min() >= 0


def test_near_an_edge_the_gel_falls_as_two_exponentials() -> None:
    """0.45 exp(-d/0.25) + 0.55 exp(-d/1.1) of the height, up to 11 % of it lower: a sweep's step rounds the corner."""
    x, _ = grids(LR)
    wall = np.where(x < 0, np.float32(0.5), np.float32(0))
    surface = deformation(wall, LR)[120] / 0.5
    for d in (0.3, 0.6, 1.0, 1.5):
        expected = 0.45 * np.exp(-d / 0.25) + 0.55 * np.exp(-d / 1.1)
        assert -0.11 < float(np.interp(d, x[120], surface)) - expected < 0.01


def test_a_narrow_groove_is_bridged_and_a_wide_one_is_not() -> None:
    """Across 0.3 mm the gel stays above 70 % of the height, across 4 mm it falls below 25 %."""
    x, _ = grids(LR)
    for width, low, high in ((0.3, 0.7, 1.0), (4.0, 0.0, 0.25)):
        ridge = np.where(np.abs(x) > width / 2, np.float32(0.4), np.float32(0))
        assert low < deformation(ridge, LR)[120, 160] / 0.4 < high


@pytest.mark.parametrize("field", [HR, native_field()])
def test_the_imprint_is_the_same_at_every_resolution(field: Field) -> None:
    """Shrunk to 320x240 over the same view, a finer imprint differs by under 12 micrometres rms of 400."""
    fine = imprint(field)
    if field.size != HR.size:
        rows, columns = field.shape[0] // 7, field.shape[1] // 7
        fine = fine[rows:-rows, columns:-columns]
    difference = cv2.resize(fine, LR.size, interpolation=cv2.INTER_AREA) - imprint(LR)
    assert float(np.sqrt((difference**2).mean())) < 0.012


def test_what_stays_after_release_fades_and_never_hides_a_new_press() -> None:
    """12 % at once, about 8 % after a second, and a present imprint that is deeper stays as it is."""
    flat, before = np.zeros((4, 4), np.float32), np.full((4, 4), 0.5, np.float32)
    assert np.allclose(residual_imprint(flat, before, 0.0), 0.06, atol=1e-6)
    assert np.allclose(residual_imprint(flat, before, 1.0), 0.5 * (0.06 + 0.06 / np.e), atol=1e-6)
    assert (residual_imprint(before, before, 0.0) == before).all()
