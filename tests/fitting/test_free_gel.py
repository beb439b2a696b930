"""The free gel estimated from presses of known light, parts and dots."""

import numpy as np
import pytest

from calibration.fitting.presses.free_gel import estimate_free_gel

ROWS, COLUMNS = np.mgrid[:120, :160]
RNG = np.random.default_rng(0)
U8 = np.ndarray


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
    found = estimate_free_gel(presses(places))
    assert np.abs(found.picture - light()).max(axis=2).mean() < error
    assert found.filled.mean() == pytest.approx(share, abs=0.1)
    assert str(found).startswith("estimated from 12 presses")
    assert ("continued from the surroundings" in str(found)) == (share > 0)
    assert found.doubt == ""


def test_another_light_is_noticed() -> None:
    """Another exposure is no other light; one side of it in another colour is."""
    found = estimate_free_gel(presses(ANYWHERE))
    assert found.find_foreign(picture(light())) == found.find_foreign(picture(0.8 * light())) == ""
    assert "another light, gel or sensor" in found.find_foreign(picture(light(tilt=40)))


def test_what_is_not_seen_is_said_and_no_picture_is_refused_by_it() -> None:
    """Dots, a faint texture over the whole view, and a part over half of the rim."""
    dots = (ROWS % 20 < 6) & (COLUMNS % 20 < 6)
    dotted = [np.where(dots[..., None], 20, one).astype(np.uint8) for one in presses(ONE_PLACE)]
    stripes = 60 * np.sign(np.sin(ROWS / 6.0))[..., None] * (COLUMNS < 130)[..., None]
    wide = [picture(light() + stripes) for _ in range(6)]
    faint = [picture(light() + stripes / 8) for _ in range(6)]
    covered = "dots or parts all over it"
    for pictures, doubt in ((dotted, covered), (faint, covered), (wide, "rim not seen")):
        found = estimate_free_gel(pictures)
        assert found.doubt == doubt
        assert str(found).endswith(doubt)
        assert found.find_foreign(picture(light(tilt=40))) == ""
