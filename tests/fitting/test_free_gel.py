"""The free gel estimated from presses of known light, parts and dots."""

import cv2
import numpy as np
import pytest
from marker_gel import dotted, lattice, spread

from calibration.fitting.presses.free_gel import estimate_free_gel
from calibration.fitting.presses.gel_choice import choose_free_gel
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.marker_dots import find_marker_dots

ROWS, COLUMNS = np.mgrid[:120, :160]
RNG = np.random.default_rng(0)
START = RNG.bit_generator.state
MM = 7.9
U8 = np.ndarray


@pytest.fixture(autouse=True)
def same_noise() -> None:
    """Each test has the same noise, whatever ran before."""
    RNG.bit_generator.state = START


def light(tilt: float = 0.0) -> np.ndarray:
    """A light that falls off to the sides, another for each colour."""
    x, y = COLUMNS / 80 - 1, ROWS / 60 - 1
    planes = [130 - 30 * x**2 + 20 * y, 120 + 25 * x - 10 * x * y, 110 - 20 * y**2 + tilt * x]
    return np.stack(planes, axis=-1)


def picture(levels: np.ndarray) -> U8:
    return np.clip(np.rint(levels + RNG.normal(0, 1, levels.shape)), 0, 255).astype(np.uint8)


def disc(x: float, y: float, radius: float) -> np.ndarray:
    """A ball's colours: one side brighter, the other darker."""
    inside = (COLUMNS - x) ** 2 + (ROWS - y) ** 2 < radius**2
    return np.where(inside, 60 * np.sign(COLUMNS - x + 1e-9), 0)[..., None]


def presses(places: list[tuple[float, float, float]]) -> list[U8]:
    return [picture(light() + disc(*place)) for place in places]


ANYWHERE = [(30 + 9 * k, 30 + 31 * k % 60, 18.0) for k in range(12)]
ONE_PLACE = [(80 + k % 3, 60 - k % 2, 32.0) for k in range(12)]


@pytest.mark.parametrize(("places", "share", "error"), [(ANYWHERE, 0.0, 1.5), (ONE_PLACE, 0.25, 3.0)])
def test_the_light_is_found(places: list[tuple[float, float, float]], share: float, error: float) -> None:
    """Where presses lie apart their median is it; where all touch it goes on from around, and that is said."""
    found = estimate_free_gel(presses(places), MM)
    assert np.abs(found.picture - light()).max(axis=2).mean() < error
    assert found.filled.mean() == pytest.approx(share, abs=0.1)
    assert str(found).startswith("estimated from 12 presses")
    assert ("continued from the surroundings" in str(found)) == (share > 0)
    assert found.doubt == ""


def bent(place: tuple[float, float, float], levels: float) -> U8:
    """A disc around which the gel bends by so many levels."""
    x, y, radius = place
    away = np.maximum(np.hypot(COLUMNS - x, ROWS - y) - radius, 0)
    bend = levels * np.sign(COLUMNS - x + 1e-9) * np.exp(-away / 12)
    return picture(light() + disc(*place) + bend[..., None])


def test_a_gel_that_bends_beside_parts_holds_none_of_them() -> None:
    """Where they lie apart most presses agree; at one place they differ by their depth, and their contacts show."""
    assert estimate_free_gel([bent(place, 10) for place in ANYWHERE], MM).doubt == ""
    found = estimate_free_gel([bent(place, 4.0 * k) for k, place in enumerate(ONE_PLACE)], MM)
    assert found.doubt == "it may hold some of the part"
    assert found.shows_contacts


def test_another_light_is_noticed() -> None:
    """Another exposure is no other light; one side of it in another colour is, and all of it in one that a station
    would take for its lamp's own change."""
    found = estimate_free_gel(presses(ANYWHERE), MM)
    assert found.find_foreign(picture(light())) == found.find_foreign(picture(0.8 * light())) == ""
    assert found.find_foreign(picture(light() * [0.98, 1, 1.02])) == ""
    assert "another light, gel or sensor" in found.find_foreign(picture(light(tilt=40)))
    assert "in a colour: another light" in found.find_foreign(picture(light() * [0.9, 1, 1.1]))


def test_an_even_light_is_no_other_light() -> None:
    """In the middle of the gel colours hardly change from place to place, and noise is as large as that."""
    even = 128 + (light() - 128) * [0.02, 0.3, 0.02]
    found = estimate_free_gel([picture(even + disc(*place)) for place in ANYWHERE], MM)
    assert found.doubt == found.find_foreign(picture(even)) == ""
    assert "in a colour: another light" in found.find_foreign(picture(even * [0.9, 1, 1.1]))


def test_the_dots_of_a_marker_gel_have_their_free_places() -> None:
    """Each press has sheared them; the parts lie apart."""
    plain = [cv2.resize(rgb, (320, 240)) for rgb in (picture(light()), *presses(ANYWHERE))]
    places = lattice((240, 320))
    right = dotted(plain[0], places)
    middles = [(2 * x, 2 * y) for x, y, _ in ANYWHERE]
    sheared = [dotted(rgb, spread(places, at)) for rgb, at in zip(plain[1:], middles, strict=True)]
    found = estimate_free_gel(sheared, 2 * MM)
    assert found.doubt == ""
    assert found.find_foreign(right) == ""
    away = find_marker_dots(found.picture, 2 * MM).find_shifts(right)  # type: ignore[union-attr]
    assert np.nanmedian(np.hypot(*away.T)) < 1.2  # where presses overlap most of them shear one way


def test_a_press_of_a_plain_gel_among_those_of_a_marker_gel_does_not_spoil_the_estimate() -> None:
    """It shows no dot, so it does not tell where they lie, and how dark they are."""
    free, *plain = [cv2.resize(rgb, (320, 240)) for rgb in (picture(light()), *presses(ANYWHERE))]
    places = lattice((240, 320))
    middles = [(2 * x, 2 * y) for x, y, _ in ANYWHERE]
    sheared = [dotted(rgb, spread(places, at)) for rgb, at in zip(plain, middles, strict=True)]

    found = estimate_free_gel([sheared[0], plain[1], *sheared[2:]], 2 * MM)

    assert found.find_foreign(dotted(free, places)) == ""
    assert find_marker_dots(found.picture, 2 * MM) is not None


def test_what_is_not_seen_is_said_and_no_picture_is_refused_by_it() -> None:
    """A faint texture over the whole view, a part over half of the rim, and one that looks like light."""
    stripes = 60 * np.sign(np.sin(ROWS / 6.0))[..., None] * (COLUMNS < 130)[..., None]
    wide = [picture(light() + stripes) for _ in range(6)]
    faint = [picture(light() + stripes / 8) for _ in range(6)]
    down = ((ROWS / 60 - 1) - (ROWS / 60 - 1) ** 3)[..., None]
    curved = [picture(light() + (25 + 3 * k) * down) for k in range(6)]
    deeper = [picture(light() + 30 * k * down) for k in range(8)]  # some of it stands out a little
    held = "it may hold the part"
    doubts = ("dots or parts all over it", "rim not seen", held, held)
    for pictures, doubt in zip((faint, wide, curved, deeper), doubts, strict=True):
        found = estimate_free_gel(pictures, MM)
        assert found.doubt == doubt
        assert not found.shows_contacts
        assert str(found).endswith(doubt)
        assert found.find_foreign(picture(light(tilt=40))) == ""


@pytest.mark.parametrize(("places", "is_said"), [(ANYWHERE, False), (ONE_PLACE, True)])
def test_an_estimate_says_what_it_may_hold(places: list[tuple[float, float, float]], is_said: bool) -> None:
    """What is smooth is never noticed where all presses show it at one place."""
    pictures = [cv2.resize(rgb, (320, 240)) for rgb in presses(places)]

    chosen = choose_free_gel(pictures, {}, [], profile("cropped_lr"))

    assert chosen.faults == []
    assert chosen.estimated.endswith("; what is smooth and always at one place counts as gel") == is_said
