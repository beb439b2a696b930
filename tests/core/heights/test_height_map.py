"""Heights of lit surfaces with closed forms, and every picture in which none can be measured."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from lit_surface import MM_PER_PX, calibration, free_gel, grid, light, other_gel

from edge.core.arrays import F64, U8
from edge.core.errors import HeightError
from edge.core.heights.calibration import SIZE, HeightCalibration
from edge.core.heights.height_map import HeightMap, free_picture, measure_heights


def sphere(radius: float = 4.0, depth: float = 0.5) -> F64:
    x, y = grid()
    return np.maximum(np.sqrt(np.maximum(radius**2 - x * x - y * y, 0)) - (radius - depth), 0)


def cone() -> F64:
    """1 in 4, 0.5 mm high."""
    x, y = grid()
    return np.maximum(0.5 - np.hypot(x, y) / 4, 0)


def step() -> F64:
    """A plateau of 5 x 5 mm, 0.2 mm high, whose flanks take 0.6 mm."""
    x, y = grid()
    away = np.maximum(np.abs(x), np.abs(y)) - 2.5
    return 0.2 * np.clip(0.5 - away / 0.6, 0, 1)


def waves() -> F64:
    """Of 2 mm, 0.05 mm from the mean, under a smooth window."""
    x, y = grid()
    return 0.1 * np.clip(3 - np.hypot(x, y) / 1.5, 0, 1) * (1 + 0.5 * np.sin(2 * np.pi * x / 2))


SURFACES: dict[str, Callable[[], F64]] = {"sphere": sphere, "cone": cone, "step": step, "waves": waves}


def measured(surface: F64, noise: float = 0.0) -> HeightMap:
    return measure_heights(light(surface, calibration(), noise), free_gel(), calibration())


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_surfaces_come_back(name: str, noise: float) -> None:
    """Within 4 % of the height at the top, and 6 micrometres rms over the view, with a camera's noise too: noise hides
    in no gain of the light."""
    surface = SURFACES[name]()
    found = measured(surface, noise)
    error = found.heights_mm - surface
    assert float(np.sqrt((error**2).mean())) < 0.006
    assert found.heights_mm.max() == pytest.approx(surface.max(), rel=0.04)
    assert np.isfinite(found.heights_mm).all()
    assert (np.abs(error) <= found.u95_mm).mean() > 0.95
    away_mm = cv2.distanceTransform((~found.touched).astype(np.uint8), cv2.DIST_L2, 5) * MM_PER_PX
    assert away_mm[found.free].min() == pytest.approx(1.5, abs=0.1)  # it is lifted around a touch


def test_the_light_of_another_day_changes_no_height() -> None:
    """Press and free gel a tenth darker: the colours answer a slope a tenth less, and it is known."""
    rgb = light(sphere(), calibration())
    dim, free = (np.rint(picture * 0.9).astype(np.uint8) for picture in (rgb, free_gel()))
    found = measure_heights(dim, free, calibration())
    assert found.heights_mm.max() == pytest.approx(0.5, rel=0.04)


def test_equal_pictures_give_equal_bytes() -> None:
    rgb = light(cone(), calibration(), 2.0)
    one, other = (measure_heights(rgb, free_gel(), calibration()).heights_mm for _ in range(2))
    assert one.tobytes() == other.tobytes()


def test_a_picture_that_no_surface_gives_stays_finite() -> None:
    """Random and black squares on the free gel."""
    rng = np.random.default_rng(1)
    for square in (np.zeros((80, 80, 3), np.uint8), rng.integers(0, 250, (80, 80, 3)).astype(np.uint8)):
        rgb = free_gel()
        rgb[80:160, 120:200] = square
        found = measure_heights(rgb, free_gel(), calibration())
        assert np.isfinite(found.heights_mm).all()


def test_the_view_of_the_archive_becomes_a_picture() -> None:
    view = free_gel()[::2, ::2].astype(np.float32)
    made = free_picture(view)
    assert (made.shape, made.dtype) == ((SIZE[1], SIZE[0], 3), np.uint8)


def burnt() -> U8:
    rgb = light(sphere(), calibration())
    touched = np.abs(rgb.astype(int) - free_gel()).max(axis=2) > 12
    return np.where(touched[..., None], 255, rgb).astype(np.uint8)


def full() -> U8:
    """Waves over the whole view."""
    x, _ = grid()
    return light(0.1 * np.sin(2 * np.pi * x / 3), calibration())


@pytest.mark.parametrize(
    ("rgb", "free", "by", "serial", "sentence"),
    [
        (free_gel(), free_gel(), calibration(), None, "nothing presses the gel: colours change by 0 levels"),
        (
            burnt(),
            free_gel(),
            calibration(),
            None,
            r"^\d+% of the contact is saturated, at most 10% .*lower the exposure",
        ),
        (
            full(),
            free_gel(),
            calibration(),
            None,
            r"^\d% of the view show free gel, at least 5% are expected",
        ),
        (
            free_gel()[:200],
            free_gel(),
            calibration(),
            None,
            "the press is 320x200, heights are calibrated at 320x240",
        ),
        (
            free_gel(),
            free_gel(),
            other_gel(),
            None,
            "differs from that of calibration 'lit' by .* calibrate again",
        ),
        (
            free_gel(),
            free_gel(),
            calibration(),
            "2BNN4ZE8",
            "is of sensor 2BNN4ZE7, this press is of sensor 2BNN4ZE8",
        ),
    ],
)
def test_what_cannot_be_measured_is_a_sentence(
    rgb: U8, free: U8, by: HeightCalibration, serial: str | None, sentence: str
) -> None:
    """No contact, no exposure, a part over the view, another size, another gel and another sensor."""
    object.__setattr__(by, "serial", "2BNN4ZE7")
    with pytest.raises(HeightError, match=sentence):
        measure_heights(rgb, free, by, serial)


def test_the_scale_is_that_of_the_calibration() -> None:
    assert measured(cone()).mm_per_px == MM_PER_PX
