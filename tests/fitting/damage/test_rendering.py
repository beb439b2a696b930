"""Damage rendered into a finished press changes it as damage on the part itself would have."""

import dataclasses

import numpy as np
import pytest
from pressed_dome import DEPTH_MM, REGION, Bench

from calibration.fitting.damage.damage import KINDS, Damage, Spot
from calibration.fitting.damage.imprint import Station
from calibration.fitting.damage.rendering import EditedPress, is_compressed
from calibration.simulator.field_of_view import grids
from edge.core.imaging.region import Region
from edge.core.imaging.smoothing import smooth


def without(bench: Bench, effect: str) -> Bench:
    """The same station without one effect."""
    return Bench(dataclasses.replace(bench.gel, effects=set(bench.gel.effects) - {effect}))


@pytest.fixture(scope="module")
def edited(station: Station, bench: Bench) -> EditedPress:
    return EditedPress(station, np.ascontiguousarray(REGION.crop(bench.press(0))))


def test_the_surface_is_the_imprint(edited: EditedPress, bench: Bench) -> None:
    """From the colours of one press: the imprint's shape, and its height to a third."""
    true = REGION.crop(bench.gel.imprint(bench.height(0), DEPTH_MM * bench.placed(0).depth_factor))
    pressed = true > 0.05
    assert np.corrcoef(edited.surface[pressed], true[pressed])[0, 1] > 0.95
    assert float(edited.surface.max() / true.max()) == pytest.approx(1.15, abs=0.2)


def test_the_contact_is_where_the_part_touches(edited: EditedPress, bench: Bench) -> None:
    """Nine in ten points of the contact touch, and the gel hanging round the part is not of it."""
    touching = REGION.crop(bench.height(0)) + DEPTH_MM * bench.placed(0).depth_factor > 0
    assert touching[edited.contact].mean() > 0.9
    assert edited.contact[touching].mean() > 0.5


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("effect", "likeness"), [("jpeg", 0.9), ("", 0.6)])
def test_rendered_damage_is_like_real_damage(
    kind: str, effect: str, likeness: float, station: Station, bench: Bench
) -> None:
    """The change of the picture agrees in shape and size with that of a press on a part that is really damaged.
    Without the camera's compression nearly everywhere; with it as far as its rounding, which is of its size,
    allows."""
    bench = without(bench, effect)
    press = EditedPress(station, np.ascontiguousarray(REGION.crop(bench.press(0))))
    damage = Damage(kind, KINDS[kind].largest_mm / 3, Spot(0.3, -0.4, 0.7))
    rendered = press.render(damage).astype(np.float64) - press.rgb
    real = REGION.crop(bench.press(0, damage)).astype(np.float64) - press.rgb
    x, y = grids(station.field)
    near = np.hypot(x - damage.spot.x_mm, y - damage.spot.y_mm) < 1.5
    assert np.corrcoef(rendered[near].ravel(), real[near].ravel())[0, 1] > likeness
    assert np.sqrt((rendered[near] ** 2).sum() / (real[near] ** 2).sum()) == pytest.approx(1.0, abs=0.15)


def test_a_smoothed_press_is_smoothed_with_its_damage(station: Station, edited: EditedPress) -> None:
    """What is rendered is as blurred as what was pressed."""
    smoothed, nothing = (
        EditedPress(station, edited.rgb, is_smoothed=True),
        np.zeros(edited.surface.shape, np.float32),
    )
    np.testing.assert_array_equal(smoothed.with_relief(nothing), smooth(edited.with_relief(nothing)))


def test_compression_is_seen_and_repeated(edited: EditedPress, bench: Bench) -> None:
    """The blocks of JPEG are found in a press that has them, at any place of the region, and in no other."""
    plain = without(bench, "jpeg").press(0)
    for region in (REGION, Region(101, 61, 120, 110)):
        assert is_compressed(region.crop(bench.press(0)), region)
        assert not is_compressed(region.crop(plain), region)
    assert is_compressed(edited.render(Damage("dent", 0.1, Spot(0, 0, 0))), REGION)


def test_nothing_changes_where_nothing_touches(bench: Bench, station: Station) -> None:
    """A dent next to the contact leaves the picture as it is, to a level of rounding."""
    edited = EditedPress(station, np.ascontiguousarray(REGION.crop(without(bench, "jpeg").press(0))))
    corner = Damage("dent", 0.2, Spot(-2.9, -2.9, 0.0))
    assert not edited.contact[:6, :6].any()
    changed = np.abs(edited.render(corner).astype(int) - edited.rgb)
    assert changed.max() <= 1


@pytest.mark.parametrize(("kind", "sign"), [("dent", -1), ("bump", 1), ("scratch", -1)])
def test_a_size_is_a_depth_or_a_height(kind: str, sign: int, station: Station) -> None:
    """A dent or scratch of 0.1 mm is 0.1 mm deep at its middle, a bump as high."""
    x, y = grids(station.field)
    relief = Damage(kind, 0.1, Spot(float(x[48, 48]), float(y[48, 48]), 0.3)).relief(x, y)
    assert relief[48, 48] == pytest.approx(sign * 0.1, rel=0.05)
    assert np.abs(relief).max() == pytest.approx(0.1, rel=0.05)
