"""Roughness of sine waves, whose Ra and Rz are known, and what is below the limit of a gel."""

from dataclasses import replace

import numpy as np
import pytest
from lit_surface import MM_PER_PX, calibration, grid

from edge.core.arrays import F64
from edge.core.errors import HeightError
from edge.core.heights.height_map import HeightMap
from edge.core.heights.roughness import Roughness, measure_roughness
from edge.core.imaging.region import Region

ALL = Region(20, 20, 280, 200)


def height_map(heights: F64, noise_mm: float = 0.0005) -> HeightMap:
    flat = np.zeros(heights.shape, bool)
    made = replace(calibration(), noise_mm=noise_mm)
    return HeightMap(heights.astype(np.float32), heights.astype(np.float32), ~flat, flat, MM_PER_PX, made)


def wave(amplitude_mm: float, length_mm: float) -> F64:
    x, _ = grid()
    return amplitude_mm * np.sin(2 * np.pi * x / length_mm)


def test_a_sine_has_the_roughness_of_its_closed_form() -> None:
    """0.02 mm from the mean, 0.5 mm long: the filters of 0.25 and 0.8 mm leave 0.841 - 0.170 = 0.671 of it. Ra is
    2 / pi of that, Rz twice; along y there is nothing."""
    left = 20 * (np.exp2(-((0.25 / 0.5) ** 2)) - np.exp2(-((0.8 / 0.5) ** 2)))
    found = {(one.parameter, one.along): one for one in measure_roughness(height_map(wave(0.02, 0.5)), ALL)}
    assert found["Ra", "x"].value_um == pytest.approx(2 / np.pi * left, rel=0.03)
    assert found["Rz", "x"].value_um == pytest.approx(2 * left, rel=0.06)
    assert found["Sa", ""].value_um == pytest.approx(2 / np.pi * left, rel=0.03)
    assert found["Sz", ""].value_um == pytest.approx(2 * left, rel=0.06)
    assert found["Ra", "y"].value_um is None


def test_form_and_waviness_are_no_roughness() -> None:
    """A tilted dome of 0.3 mm, and waves of 6 mm: less than 1 micrometre is left of them."""
    x, y = grid()
    form = 0.02 * x - 0.01 * y - 0.004 * (x * x + y * y) + wave(0.01, 6.0)
    assert all((one.value_um or 0.0) < 1.0 for one in measure_roughness(height_map(form), ALL))


def test_below_the_limit_there_is_no_number() -> None:
    """Ra of noise is 0.8 of its standard deviation: what is not three times that is not told from it."""
    found = {
        one.parameter: one
        for one in measure_roughness(height_map(wave(0.001, 0.5), 0.001), Region(20, 20, 280, 40))
    }
    assert found["Ra"].value_um is None
    assert str(found["Ra"]) == "Ra along x is below 2.4 um"


@pytest.mark.parametrize(
    ("region", "cut_off_mm", "sentence"),
    [
        (Region(0, 0, 70, 20), 0.8, r"the region is 70x20 pixels .* a cut-off of 0\.8 mm needs 77 pixels"),
        (Region(0, 0, 200, 150), 2.5, r"a cut-off of 2\.5 mm needs 235 pixels"),
        (Region(0, 100, 320, 100), 0.8, "50% of the region 0,100,320x100 is not touched"),
    ],
)
def test_a_region_that_cannot_serve_is_refused(region: Region, cut_off_mm: float, sentence: str) -> None:
    """Too small for the cut-off, and beyond the contact."""
    heights = height_map(wave(0.02, 0.5))
    heights.touched[150:] = False
    with pytest.raises(HeightError, match=sentence):
        measure_roughness(heights, region, cut_off_mm)


def test_a_number_is_said_with_its_uncertainty() -> None:
    assert str(Roughness("Sa", "", 12.34, 0.56, 1.0)) == "Sa 12.3 um, +- 0.6 um (95 %)"
    assert str(Roughness("Rz", "y", 12.34, 0.56, 1.0)).startswith("Rz along y 12.3 um")


def test_the_uncertainty_is_of_the_heights_twice_the_scale_and_the_noise() -> None:
    """Slopes are wrong by the share of the scale, and so are lengths. Ra of a noise of 0.5 um is 0.4 um."""
    heights = height_map(wave(0.02, 0.5))
    made = heights.calibration
    found = next(one for one in measure_roughness(heights, ALL) if one.parameter == "Sa")
    assert found.value_um is not None
    share = made.height_u95 + 2 * made.scale_u95
    assert found.u95_um == pytest.approx(found.value_um * share + 0.4)
