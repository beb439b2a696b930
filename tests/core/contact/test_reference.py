"""The reference, the level fit, and where a view is touched."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from contact_frames import read_view
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from edge.core.contact.mask import Touch, is_black, measure_change, touched, touched_mask
from edge.core.contact.reference import Levels, Reference, View, fit_levels


@cache
def free_gel(seed: int = 0) -> View:
    """A vignetted three-colour background, 120x160, levels 40 to 160."""
    y, x = np.mgrid[0:120, 0:160].astype(np.float32)
    shade = np.exp(-(((x - 80) / 90) ** 2 + ((y - 60) / 70) ** 2))
    colours = np.stack([150 - y * 0.5, 60 + x * 0.4, 60 + y * 0.6], axis=-1)
    noise = np.random.default_rng(seed).normal(0, 1.3, (120, 160, 3))
    return (20 + colours * shade[..., None] + noise).astype(np.float32)


def ball(view: View, radius: float = 20, x: float = 80, y: float = 60) -> View:
    """A pressed ball: red brightens above and darkens below, green right against left."""
    rows, columns = np.mgrid[0:120, 0:160].astype(np.float32)
    u, v = (columns - x) / radius, (rows - y) / radius
    inside = (u * u + v * v <= 1).astype(np.float32)
    slopes = np.stack([-60 * v, 55 * u, 60 * v], axis=-1) * inside[..., None]
    return (view + slopes).astype(np.float32)


@cache
def reference() -> Reference:
    mean = np.mean([free_gel(seed) for seed in range(10)], axis=0).astype(np.float32)
    return Reference(mean)


def disc_share(mask: NDArray[np.bool_]) -> float:
    return touched(mask).area


@settings(max_examples=50, deadline=None)
@given(
    st.tuples(*[st.floats(0.75, 1.3)] * 3),
    st.tuples(*[st.floats(-10, 10)] * 3),
    st.booleans(),
    st.integers(10, 40),
)
def test_a_drift_of_level_is_no_contact_and_hides_none(
    gains: tuple[float, ...], offsets: tuple[float, ...], is_pressed: bool, radius: int
) -> None:
    """Any gain and offset per channel: the free gel stays free, and a ball's area stays what it was."""
    view = ball(free_gel(99), radius) if is_pressed else free_gel(99)
    expected = disc_share(touched_mask(view - reference().view))
    drifted = (view * np.float32(gains) + np.float32(offsets)).astype(np.float32)
    found = disc_share(touched_mask(reference().difference(drifted)))
    assert found == pytest.approx(expected, abs=0.02 if is_pressed else 0)
    assert (found > 0) == is_pressed


def test_without_the_fit_a_drift_is_contact() -> None:
    """The case that the fit is for: 20 % more light is everywhere over the threshold."""
    drifted = free_gel(99) * np.float32(1.2)
    assert disc_share(touched_mask(drifted - reference().view)) > 0.3
    assert disc_share(touched_mask(reference().difference(drifted))) == 0


def test_the_fit_is_blind_to_the_part() -> None:
    """A ball over a quarter of the view moves the level elsewhere by less than a level."""
    difference = reference().difference(ball(free_gel(5), 39))
    outside = np.hypot(*(np.mgrid[0:120, 0:160] - np.array([60, 80])[:, None, None])) > 42
    assert np.abs(difference[outside].mean(axis=0)).max() < 1.0


@pytest.mark.parametrize("share", [0.5, 0.7])
@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.8, 0.0), (1.2, 0.0), (1.1, -8.0), (0.9, 10.0)])
def test_a_part_over_most_of_the_view_keeps_its_edge(share: float, gain: float, offset: float) -> None:
    """A rough part over 70 % of the view: the free rest stays free, whatever the exposure does."""
    relief = cv2.GaussianBlur(
        np.random.default_rng(0).normal(0, 1, (120, 160, 3)).astype(np.float32), (0, 0), 3
    )
    edge = int(160 * share)
    view = free_gel(99).copy()
    view[:, :edge] += (35 / relief.std() * relief)[:, :edge]
    mask = touched_mask(
        reference().difference((view * np.float32(gain) + np.float32(offset)).astype(np.float32))
    )
    assert touched(mask).area == pytest.approx(share, abs=0.02)
    assert not mask[:, edge + 2 :].any()


def test_known_levels_are_found() -> None:
    """reference = gain * view + offset, to a hundredth and a tenth of a level."""
    view = free_gel(1)
    levels = fit_levels(
        view, (view * np.float32([1.1, 0.9, 1.0]) + np.float32([3, -4, 0])).astype(np.float32)
    )
    assert levels.gain == pytest.approx([1.1, 0.9, 1.0], abs=0.01)
    assert levels.offset == pytest.approx([3, -4, 0], abs=0.5)
    unchanged = Levels(np.ones(3, np.float32), np.zeros(3, np.float32))
    assert np.array_equal(unchanged.applied(view), view)


@pytest.mark.parametrize("value", [0.0, 128.0, 255.0])
def test_flat_views_give_finite_differences(value: float) -> None:
    """A black or saturated view has no contrast to fit; the result is still finite."""
    flat = np.full((120, 160, 3), value, np.float32)
    for view, ref in (
        (flat, reference()),
        (free_gel(), Reference(flat)),
        (flat, Reference(flat)),
    ):
        assert np.isfinite(ref.difference(view)).all()
    assert np.abs(Reference(flat).difference(flat)).max() < 1e-3


def test_differences_are_signed() -> None:
    """0 against 255 is -255, not 1 as uint8 would have it; darker and brighter are both contact."""
    low, high = np.zeros((120, 160, 3), np.float32), np.full((120, 160, 3), 255, np.float32)
    assert (low - high == -255).all()
    assert measure_change(low, high) == 1.0
    assert measure_change(high, low) == 1.0
    for sign in (-40.0, 40.0):
        difference = np.zeros((120, 160, 3), np.float32)
        difference[40:80, 60:100, 1] = sign
        assert touched(touched_mask(difference)).area == pytest.approx(1600 / 19200)


def test_a_pixel_has_changed_beyond_twelve_levels_of_a_colour() -> None:
    """Noise moves none this far; half of these pixels have changed by 13, the others by 12."""
    view = np.full((120, 160, 3), 100, np.float32)
    changed = view + np.float32(12)
    changed[:60, :, 1] += 1
    assert measure_change(changed, view) == 0.5


def test_uint8_never_gets_in() -> None:
    """A uint8 reference is refused, because its differences would wrap."""
    with pytest.raises(ValueError, match="float32"):
        Reference(np.zeros((120, 160, 3), np.uint8))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="finite"):
        Reference(np.full((4, 4, 3), np.nan, np.float32))


def test_specks_and_noise_are_no_area() -> None:
    """Dust of 4x4 pixels and lone pixels vanish in the opening, and 5x5 stay; stripes 4 pixels apart close to one
    area, and 5 pixels apart none."""
    difference = np.zeros((120, 160, 3), np.float32)
    difference[::20, ::20] = 80
    difference[50:54, 70:74] = -80
    assert touched(touched_mask(difference)) == Touch(0.0)
    difference[:] = 0
    difference[50:55, 70:75] = difference[50:55, 80:85] = -80
    assert touched(touched_mask(difference)).area == 50 / 19200
    stripes = np.zeros((120, 160, 3), np.float32)
    stripes[40:80:6, 40:100] = 80
    stripes[41:80:6, 40:100] = 80
    assert touched(touched_mask(stripes)).area == pytest.approx(38 * 60 / 19200, rel=0.02)


def test_the_centroid_is_where_the_part_is() -> None:
    """In fractions of width and height, of pixel centres."""
    mask = np.zeros((120, 160), np.bool_)
    mask[30:60, 40:80] = True
    assert touched(mask) == Touch(1200 / 19200, x=60 / 160, y=45 / 120)
    with pytest.raises(ValueError, match="fractions"):
        Touch(1.5)


def test_a_refresh_moves_part_of_the_way() -> None:
    """By its weight, and by nothing outside 0 to 1."""
    old = Reference(np.zeros((2, 2, 3), np.float32))
    new = old.refresh(np.full((2, 2, 3), 10, np.float32), 0.3)
    assert new.view == pytest.approx(np.full((2, 2, 3), 3.0))
    with pytest.raises(ValueError, match="weight"):
        old.refresh(old.view, 1.5)


def test_black_is_told_from_dim() -> None:
    assert is_black(np.zeros((120, 160, 3), np.float32))
    assert not is_black(free_gel())


REAL = {
    "rpl-cmu__gelslam": ("background.png", "*mm/*/gelsight.png", 67),
    "skleff1994__gs_sdk": ("background.png", "*mm/*/gelsight.png", 51),
    "FabPrez__Taxim": ("gsmini_ball5.0/frame_0.jpg", "gsmini_ball5.0/frame_[1-9]*.jpg", 49),
}


@pytest.mark.parametrize("source", sorted(REAL))
def test_every_real_press_is_a_touch_whatever_the_exposure(real_tactile: Path, source: str) -> None:
    """All ball presses of three real sensors, with the light ramped by up to a fifth: touched, and equally large. The
    untouched gel under the same ramp is free; without the fit nearly all of it would count as contact."""
    free_name, pattern, count = REAL[source]

    free = read_view(real_tactile / source / free_name)
    known = Reference(free)
    paths = sorted((real_tactile / source).glob(pattern))
    assert len(paths) == count
    for path, gain in zip(paths, np.linspace(0.8, 1.2, count), strict=True):
        press = read_view(path)
        area = touched(touched_mask(known.difference(press))).area
        ramped = np.clip(press * np.float32([gain, 1.0, 2 - gain]), 0, 255).astype(np.float32)
        assert area > 0.015
        assert touched(touched_mask(known.difference(ramped))).area == pytest.approx(area, abs=0.003)
        drifted = np.clip(free * np.float32([gain, 1.0, 2 - gain]), 0, 255).astype(np.float32)
        assert touched(touched_mask(known.difference(drifted))).area == 0
