"""Light: three sides, three colours, shadows behind relief, and what the camera adds."""

import cv2
import numpy as np

from calibration.simulator import camera as cam
from calibration.simulator import gel_surface, optics, sensor_appearance
from calibration.simulator.field_of_view import F32, HR, LR, Field, grids, native_field
from calibration.simulator.pose import Pose, contact, sample
from calibration.simulator.renderer import Renderer
from calibration.simulator.sensor_appearance import SENSORS


def ball(radius_mm: float = 3.0, x0: float = 0.0, y0: float = 0.0):  # type: ignore[no-untyped-def]
    def height(x: F32, y: F32) -> F32:
        inside = np.maximum(radius_mm**2 - (x - np.float32(x0)) ** 2 - (y - np.float32(y0)) ** 2, 0)
        return np.asarray(np.sqrt(inside) - radius_mm, np.float32)

    return height


def dome(field: Field = LR, depth: float = 0.5) -> F32:
    return contact(sample(ball(), Pose(), field), depth)


def test_a_ball_is_red_on_top_blue_below_and_green_on_the_right() -> None:
    """The sides that face each light grow in its colour, as on three real units."""
    renderer = Renderer(LR, ("illumination", "deformation"))
    change = renderer.press(ball(), 0.5).astype(np.float32) - renderer.free_gel()
    middle, off = (120, 160), 18
    red, green, blue = (change[..., c] for c in range(3))
    assert red[middle[0] - off, middle[1]] > 25 > -5 > red[middle[0] + off, middle[1]]
    assert blue[middle[0] + off, middle[1]] > 15 > -5 > blue[middle[0] - off, middle[1]]
    assert green[middle[0], middle[1] + off] > 25 > -5 > green[middle[0], middle[1] - off]


def test_normals_of_a_plane_are_its_slope() -> None:
    """z = 0.3 x falls to the left: nx = -0.3 / sqrt(1.09) everywhere, ny = 0, on square and oblong pixels."""
    for field in (LR, HR):
        x, _ = grids(field)
        nx, ny = optics.normals(np.asarray(0.3 * x, np.float32), field)
        inner = (slice(2, -2), slice(2, -2))
        assert np.allclose(nx[inner], -0.3 / np.sqrt(1.09), atol=1e-4)
        assert np.allclose(ny[inner], 0, atol=1e-4)


def test_shadows_darken_only_behind_relief() -> None:
    """Nothing becomes brighter; red, which comes from the top, darkens only below the ridge, blue only above it."""
    y = grids(LR)[1]
    ridge = np.where(np.abs(y) < 0.3, np.float32(0.5), np.float32(0))
    before = np.full((3, *LR.shape), 100, np.float32)
    after = optics.shadows(before.copy(), ridge, LR)
    darker = after < before - 0.5
    assert (after <= before + 1e-4).all()
    rows = np.nonzero(darker[0].any(axis=1))[0]
    assert rows.size
    assert y[rows.min(), 0] > 0
    rows = np.nonzero(darker[2].any(axis=1))[0]
    assert y[rows.max(), 0] < 0
    assert not darker[1].any()
    assert after.min() >= 64.9


def test_a_shadow_reaches_as_far_as_the_height_over_the_lights_rise() -> None:
    """A step of 0.4 mm throws 0.4 / 0.47 = 0.85 mm, to within the half-resolution search's steps."""
    y = grids(LR)[1]
    step = np.where(y < 0, np.float32(0.4), np.float32(0))
    after = optics.shadows(np.full((3, *LR.shape), 100, np.float32), step, LR)
    reach = y[np.nonzero((after[0] < 95).any(axis=1))[0].max(), 0]
    assert 0.55 < reach < 1.0


def test_the_free_gel_has_the_measured_colours() -> None:
    """Centre and mean of unit A: red 140, green 114, blue 148 at the centre; means 78, 95, 105."""
    planes = sensor_appearance.background(SENSORS["unit_a"], LR)
    assert np.allclose(planes[:, 120, 160], np.exp([4.94, 4.74, 4.996]), rtol=0.01)
    assert np.allclose(planes.mean(axis=(1, 2)), [78, 95, 105], atol=1.5)


def test_noise_has_the_measured_spread() -> None:
    """At level 100 the sd is 2.2, 1.5 and 2.7 in red, green and blue, and the mean is kept."""
    planes = np.full((3, 200, 200), 100, np.float32)
    noisy = cam.noise(planes.copy(), np.random.default_rng(0)) - 100
    assert np.allclose(noisy.std(axis=(1, 2)), (2.2, 1.5, 2.7), rtol=0.03)
    assert np.abs(noisy.mean(axis=(1, 2))).max() < 0.05


def test_markers_are_dark_dots_that_spread_from_a_bulge() -> None:
    """There are 9 x 7 dots; right of a bulge they are further right than on the free gel."""
    flat = np.zeros(LR.shape, np.float32)
    white = np.full((3, *LR.shape), 200, np.float32)
    free = gel_surface.markers(white.copy(), flat, LR)[0] < 120
    x = grids(LR)[0]
    pressed = gel_surface.markers(white.copy(), dome(depth=0.8), LR)[0] < 120
    one = (slice(112, 129), slice(172, 216))
    assert free.any()
    assert x[one][pressed[one]].mean() > x[one][free[one]].mean() + 0.02


def test_the_native_frame_shows_the_rim_and_crops_to_the_low_resolution_frame() -> None:
    """Outside the pad it is dark; inside, cutting a seventh and shrinking gives the 320x240 frame again."""
    names = ("illumination", "deformation", "vignette")
    whole = Renderer(native_field(), names).press(ball(), 0.5)
    direct = Renderer(LR, names).press(ball(), 0.5)
    assert whole[:, :8].max() < 40
    rows, columns = whole.shape[0] // 7, whole.shape[1] // 7
    cut = cv2.resize(whole[rows:-rows, columns:-columns], (320, 240), interpolation=cv2.INTER_AREA)
    difference = np.abs(cut.astype(np.float32) - direct)
    assert difference.mean() < 1.0
