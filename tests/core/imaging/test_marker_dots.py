"""Marker dots: where they are found, where nothing is taken for them, and what is filled."""

import re
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from marker_gel import APART_PX, WIDTH_PX, dotted, lattice, light, spread

from edge.core.arrays import F64, U8
from edge.core.imaging.marker_dots import MarkerDots, find_marker_dots

PIXELS_PER_MM = 15.8
LIGHT = light()
PLACES = lattice(LIGHT.shape)


def known(places: F64 = PLACES) -> MarkerDots:
    dots = find_marker_dots(dotted(LIGHT, places), PIXELS_PER_MM)
    assert dots is not None
    return dots


def whole(places: F64) -> F64:
    """The places of dots that the border does not cut."""
    inside = (places > WIDTH_PX) & (places < 224 - WIDTH_PX)
    return np.asarray(places[inside.all(axis=1)], np.float64)


@pytest.mark.parametrize("turn_deg", [0.0, 3.0, 12.0, 40.0])
def test_dots_of_a_rendered_grid_are_found_to_a_quarter_of_a_pixel(turn_deg: float) -> None:
    """Also where the grid is turned; places beyond the border and at it continue the grid."""
    places = lattice(LIGHT.shape, turn_deg)
    dots = known(places)
    away = np.linalg.norm(whole(places)[:, None] - dots.places[None], axis=2).min(axis=1)
    assert away.max() < 0.25
    assert dots.apart_px == pytest.approx(APART_PX, abs=0.1)
    assert dots.width_px == pytest.approx(WIDTH_PX, abs=1)
    shown = places[((places > -WIDTH_PX / 2) & (places < 224 + WIDTH_PX / 2)).all(axis=1)]
    assert np.linalg.norm(shown[:, None] - dots.places[None], axis=2).min(axis=1).max() < 1


def specks(rgb: U8) -> U8:
    rng = np.random.default_rng(1)
    return dotted(rgb, rng.uniform(10, 214, (30, 2)))


def coloured_bumps(rgb: U8) -> U8:
    """A part with bumps at the places of dots: each is dark in one colour and bright in another, as lamps show it."""
    v, u = np.mgrid[0:224, 0:224].astype(float)
    x, y = ((g - PLACES[0, k] + APART_PX / 2) % APART_PX - APART_PX / 2 for k, g in enumerate((u, v)))
    bump = np.exp(-(x**2 + y**2) / 40)
    slopes = np.stack([-y * bump * 12, x * bump * 8, y * bump * 12], axis=-1)
    return np.asarray(np.clip(rgb + slopes, 0, 255), np.uint8)


def half_of_them(rgb: U8) -> U8:
    return dotted(rgb, PLACES[PLACES[:, 0] < 112])


def grooves(rgb: U8) -> U8:
    lines = rgb.copy()
    for at in range(10, 224, 20):
        lines[:, at : at + 6] //= 3
    return lines


def hexagons(rgb: U8) -> U8:
    along, row = np.meshgrid(np.arange(12), np.arange(9))
    places = np.stack([along + row % 2 / 2, row * np.sqrt(0.75)], axis=-1).reshape(-1, 2)
    return dotted(rgb, places * APART_PX)


@pytest.mark.parametrize(
    "change", [lambda rgb: rgb, lambda rgb: rgb * 0, specks, coloured_bumps, half_of_them, grooves, hexagons]
)
def test_no_dots_are_found_where_none_are(change: Callable[[U8], U8]) -> None:
    """A plain gel, a black picture, specks anywhere, a regular part, a part with dots on one side, dark lines, a
    part with holes as far apart, which are in no square."""
    assert find_marker_dots(change(LIGHT), PIXELS_PER_MM) is None


def test_noise_is_no_dots() -> None:
    rng = np.random.default_rng(0)
    assert find_marker_dots(rng.integers(0, 256, (224, 224, 3), np.uint8), PIXELS_PER_MM) is None


@pytest.mark.parametrize(
    "moved",
    [
        PLACES,
        PLACES + np.array([4.0, -7.0]),
        spread(PLACES),
        spread(PLACES, (30.0, 190.0)),
        PLACES + np.array([0.0, 11.0]),
        spread(PLACES, px=18.0),
    ],
    ids=[
        "still",
        "shifted",
        "spread",
        "spread at the border",
        "a row enters",
        "beyond half of their distance",
    ],
)
def test_moved_dots_are_filled_and_nothing_else_changes(moved: F64) -> None:
    """What is filled is the light that was there; further away every pixel is the camera's."""
    press = dotted(LIGHT, moved)
    filled = known().fill(press)
    assert np.abs(filled.astype(int) - LIGHT).max() <= 8
    apart = np.linalg.norm(np.mgrid[0:224, 0:224].T[:, :, None] - moved[None, None], axis=3).min(axis=2)
    far = apart > 1.3 * WIDTH_PX
    assert far.any()
    assert (filled == press)[far].all()


def test_dots_that_grooves_of_the_part_touch_are_filled() -> None:
    """A thread: beside its bright crests the gel is as dark as a dot, and joins the dots."""
    rgb = LIGHT.copy()
    for top in range(30, 190, 20):
        rgb[top : top + 6, 70:150, 0] = 230
    filled = known().fill(dotted(rgb, PLACES))
    assert filled.max(axis=2).min() > 0.7 * LIGHT.max(axis=2).min()


def test_a_further_dark_spot_between_dots_stays() -> None:
    """It is as large and as dark as a dot, and belongs to the part."""
    spot = PLACES[np.abs(PLACES - 112).sum(axis=1).argmin()] + APART_PX / 2
    press = dotted(LIGHT, np.vstack([spread(PLACES), spot]))
    filled = known().fill(press)
    x, y = np.rint(spot).astype(int)
    assert filled[y, x].tolist() == press[y, x].tolist()
    assert filled[y, x].max() < 0.4 * LIGHT[y, x].max()


def test_what_hides_a_dot_and_is_larger_stays() -> None:
    """Dark damage over a dot is no dot, and the dots around it are filled."""
    press = dotted(LIGHT, PLACES)
    x, y = np.rint(PLACES[np.abs(PLACES - 112).sum(axis=1).argmin()]).astype(int)
    cv2.rectangle(press, (x - 12, y - 12), (x + 12, y + 12), (20, 20, 20), -1)
    filled = known().fill(press)
    near = filled[y - 12 : y + 13, x - 12 : x + 13]
    assert near.max() == 20
    filled[y - 16 : y + 17, x - 16 : x + 17] = LIGHT[y - 16 : y + 17, x - 16 : x + 17]
    assert np.abs(filled.astype(int) - LIGHT).max() <= 8


GONE = int(np.abs(PLACES - 112).sum(axis=1).argmin())


FEWER = dotted(LIGHT, np.delete(PLACES, GONE + 1, axis=0))


@pytest.mark.parametrize(
    "learnt",
    [[], [FEWER], [dotted(FEWER, PLACES[[GONE + 1]], 0.6 * WIDTH_PX)]],
    ids=["nothing learnt", "missed", "nearly missed"],
)
def test_a_dot_that_is_not_seen_is_missed_by_none(learnt: list[U8]) -> None:
    """Where nothing is learnt of presses, or learnt presses miss dots too, or hardly show one, nothing is drawn."""
    press = dotted(LIGHT, np.delete(PLACES, GONE, axis=0))
    filled = known().learn(learnt).fill(press)
    x, y = np.rint(PLACES[GONE]).astype(int)
    assert (filled == press)[y - 6 : y + 7, x - 6 : x + 7].all()


@pytest.mark.parametrize("moved", [PLACES, spread(PLACES), PLACES + 9], ids=["still", "spread", "sheared"])
def test_a_dot_that_is_not_seen_is_drawn_where_each_learnt_press_shows_all(moved: F64) -> None:
    """At the place that its neighbours give, as dark as a dot; all else is filled as before."""
    dots = known().learn([dotted(LIGHT, spread(PLACES)), dotted(LIGHT, PLACES)])
    whole_press, press = dotted(LIGHT, moved), dotted(LIGHT, np.delete(moved, GONE, axis=0))
    filled = dots.fill(press)
    dark = filled.max(axis=2) < 0.5 * LIGHT.max(axis=2)
    centre = np.argwhere(dark).mean(axis=0)[::-1]
    assert np.abs(centre - moved[GONE]).max() < WIDTH_PX / 3
    assert dark.sum() == pytest.approx(np.pi / 4 * WIDTH_PX**2, rel=0.2)
    assert np.abs(filled.astype(int) - LIGHT)[~dark].max() <= 8
    assert (dots.fill(whole_press) == known().fill(whole_press)).all()


def test_dark_damage_that_makes_a_dot_larger_than_any_learnt_one_stays() -> None:
    """Without learnt presses a dot may be twice as large as usual, and damage beside it is filled with it."""
    press = dotted(LIGHT, np.vstack([PLACES, PLACES[GONE] + (8, 0)]), WIDTH_PX)
    x, y = np.rint(PLACES[GONE] + (8, 0)).astype(int)
    limit = 0.5 * LIGHT[y, x].max()
    assert known().fill(press)[y, x].max() > limit
    assert known().learn([dotted(LIGHT, PLACES)]).fill(press)[y, x].max() < limit


@pytest.mark.parametrize("rgb", [np.zeros((224, 224, 3), np.uint8), np.full((40, 30, 3), 255, np.uint8)])
def test_a_picture_without_dots_is_kept(rgb: U8) -> None:
    """Also a black one, and one of another size."""
    assert (known().fill(rgb) == rgb).all()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: known().fill(np.zeros((4, 4), np.uint8)), "uint8 (h, w, 3), found uint8 (4, 4)"),
        (lambda: known().fill(np.zeros((4, 4, 3), np.float32)), "uint8 (h, w, 3), found float32 (4, 4, 3)"),
        (lambda: MarkerDots(np.zeros((0, 2)), 30, 11, 0.3), "places of dots are (n, 2), found (0, 2)"),
        (lambda: MarkerDots(np.zeros((1, 2)), 10, 11, 0.3), "narrower than they lie apart"),
    ],
)
def test_nonsense_is_refused(wrong: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        wrong()


def test_dots_of_a_moved_gel_are_found_where_they_are() -> None:
    """Each with how far it lies from its place; of a picture without dots none is."""
    dots, press = known(), dotted(LIGHT, PLACES + np.array([4.0, -7.0]))
    shifts, found = dots.find_shifts(press), dots.find(press)
    seen = np.isfinite(shifts).all(axis=1)
    assert seen.mean() > 0.6
    np.testing.assert_allclose(np.median(shifts[seen], axis=0), [4.0, -7.0], atol=0.1)
    assert all(found[y, x] for x, y in np.rint(whole(PLACES + np.array([4.0, -7.0]))).astype(int))
    assert found.mean() < 0.5
    assert not dots.find(LIGHT).any()


@pytest.mark.parametrize(("apart_px", "share"), [(20.0, "44%"), (11.0, "100%")])
def test_what_is_not_judged_under_dots_is_said(apart_px: float, share: str) -> None:
    """Discs with their rims, 1.5 times as wide as the dots: pi / 4 * 15 ** 2 of 20 * 20 pixels; no more than all."""
    dots = MarkerDots(np.array([[5.0, 5.0]]), apart_px, 10.0, 0.3)
    assert str(dots).startswith(f"10 pixels wide, {apart_px:.0f} apart")
    assert str(dots).endswith(f"nothing is judged under them, {share} of the gel")
