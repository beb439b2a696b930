"""Light: three sides, three colours, shadows behind relief, and what the camera adds."""

import cv2
import numpy as np
import pytest

from calibration.simulator import camera as cam
from calibration.simulator import gel_surface, optics, sensor_appearance
from calibration.simulator.field_of_view import HR, LR, Field, grids, native_field
from calibration.simulator.pose import Pose, contact, sample
from calibration.simulator.renderer import Renderer
from calibration.simulator.sensor_appearance import SENSORS
from edge.core.arrays import F32


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


def test_gloss_leaves_flat_gel_alone_and_lights_the_side_that_faces_a_lamp() -> None:
    """Only the change to flat is added; the top of a ball gains red."""
    nx, ny = optics.normals(dome(), LR)
    after = optics.specular(np.zeros((3, *LR.shape), np.float32), nx, ny)
    assert np.abs(after[:, 5, 5]).max() < 1e-4
    assert after[0, 120 - 20, 160] > 3


def test_the_free_gel_has_the_measured_colours() -> None:
    """Centre and mean of unit A: red 140, green 114, blue 148 at the centre; means 78, 95, 105."""
    planes = sensor_appearance.background(SENSORS["unit_a"], LR)
    assert np.allclose(planes[:, 120, 160], np.exp([4.94, 4.74, 4.996]), rtol=0.01)
    assert np.allclose(planes.mean(axis=(1, 2)), [78, 95, 105], atol=1.5)


def test_vignette_gives_the_measured_background_back() -> None:
    """Lights without the lens are brighter in the corners; with the lens they are as measured."""
    lit = Renderer(LR, ("illumination", "vignette")).free_gel().astype(np.float32)
    bare = Renderer(LR, ("illumination",)).free_gel().astype(np.float32)
    measured = sensor_appearance.background(SENSORS["unit_b"], LR).transpose(1, 2, 0)
    assert np.abs(lit - measured).max() < 0.6
    assert (bare[0, 0] > lit[0, 0]).all()


def test_lens_blur_keeps_the_mean_and_softens_an_edge() -> None:
    """A step keeps its light and its steepest difference falls."""
    step = np.zeros((3, *LR.shape), np.float32)
    step[:, :, 160:] = 100
    after = cam.lens_blur(step.copy(), LR)
    assert abs(float(after.mean()) - float(step.mean())) < 0.01
    assert np.abs(np.diff(after[0], axis=1)).max() < 85


def test_motion_blur_smears_along_the_motion_only() -> None:
    """A point moving right by 20 mm/s in 18 ms becomes a line 0.36 mm long and one pixel high."""
    point = np.zeros((3, *LR.shape), np.float32)
    point[:, 120, 160] = 100
    after = cam.motion_blur(point.copy(), (20.0, 0.0), LR)[0]
    assert np.count_nonzero(after[120] > 1) in range(5, 9)
    assert np.count_nonzero(after[:, 160] > 1) == 1
    assert abs(float(after.sum()) - 100) < 0.1


def test_the_lamps_fall_by_four_percent_while_they_warm_up() -> None:
    """At power on 4 % brighter than after minutes, apart from a drift below 1 %."""
    planes = np.full((3, 8, 8), 100, np.float32)
    rng = np.random.default_rng
    cold = cam.led_drift(planes.copy(), 0.0, rng(1)).mean()
    warm = cam.led_drift(planes.copy(), 600.0, rng(1)).mean()
    assert 0.025 < cold / warm - 1 < 0.055


def test_noise_has_the_measured_spread() -> None:
    """At level 100 the sd is 2.2, 1.5 and 2.7 in red, green and blue, and the mean is kept."""
    planes = np.full((3, 200, 200), 100, np.float32)
    noisy = cam.noise(planes.copy(), np.random.default_rng(0), cam.noise_spread(planes)) - 100
    assert np.allclose(noisy.std(axis=(1, 2)), (2.2, 1.5, 2.7), rtol=0.03)
    assert np.abs(noisy.mean(axis=(1, 2))).max() < 0.05


def test_quantising_holds_black_and_white() -> None:
    """Levels below 0 and above 255 are held there; halves round to even; nothing wraps."""
    planes = np.array([-5, 0.4, 254.6, 300], np.float32)[None, None, :].repeat(3, axis=0)
    assert cam.quantise(planes)[0, :, 0].tolist() == [0, 0, 255, 255]


def test_grain_shows_more_where_the_coat_is_stretched() -> None:
    """The speckle inside an imprint is about three times that of the free gel."""
    texture = gel_surface.grain_texture(np.random.default_rng(0), LR)
    surface = np.zeros(LR.shape, np.float32)
    surface[:, 160:] = 0.3
    after = gel_surface.grain(np.zeros((3, *LR.shape), np.float32), surface, texture)
    free, touched = after[0, :, :160].std(), after[0, :, 160:].std()
    assert 2.2 < touched / free < 3.6


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


def test_dust_and_wear_only_grow() -> None:
    """Every speck, scratch and stain of a young gel is still there on an old one, and there are more."""
    dust = gel_surface.new_dust(np.random.default_rng(1))
    scratches, stains = gel_surface.new_wear(np.random.default_rng(2))
    young, old = (gel_surface.dust_relief(dust, n, LR) for n in (0, 900))
    assert (old >= young - 1e-6).all()
    assert 0 < (young > 0.005).sum() < (old > 0.005).sum()
    assert not gel_surface.wear_relief(scratches, 0, LR).any()
    assert (gel_surface.wear_relief(scratches, 900, LR) <= 0).all()
    assert (gel_surface.wear_stains(stains, 900, LR) <= gel_surface.wear_stains(stains, 300, LR) + 1e-6).all()


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


def test_a_look_of_the_wrong_shape_is_refused() -> None:
    """A table with a missing term is named with its shape."""
    with pytest.raises(ValueError, match="shape"):
        sensor_appearance.SensorAppearance("broken", np.zeros((3, 14)))


def test_jpeg_stays_near_its_picture() -> None:
    """Compression at the camera's quality moves a smooth picture by a level or two, and does move it."""
    rgb = Renderer(LR, ("illumination",)).free_gel()
    back = cam.jpeg(rgb)
    assert 0 < np.abs(back.astype(np.int16) - rgb).mean() < 2
