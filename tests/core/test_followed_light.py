"""Light that changes slowly is followed where the free gel proves that light alone has changed."""

import numpy as np
import pytest

from edge.core.imaging.followed_light import FollowedLight, find_light
from edge.core.imaging.region import Region

VIEW = tuple[float, float, float]


def free_gel(light: VIEW = (1.0, 1.0, 1.0), seed: int = 0, tint: float = 0.0) -> np.ndarray:
    """A gel under lamps of three colours that fall off across it, float32 (120, 160, 3). tint: of another gel."""
    y, x = np.mgrid[:120, :160] / 160
    level = np.stack([90 + 60 * x, 140 - 40 * y, 60 + 70 * y + 20 * x], axis=2)
    level = level + tint * np.sin(9 * x + 7 * y)[..., None] * np.array([1.0, -0.6, 0.4])
    grain = np.random.default_rng(seed).normal(0, 0.4, level.shape)
    return np.asarray(level * np.array(light) + grain, np.float32)


@pytest.mark.parametrize("light", [(0.8, 0.8, 0.8), (1.0, 1.0, 0.8), (1.15, 1.1, 1.12), (0.9, 1.0, 1.05)])
def test_a_press_comes_back_to_the_light_of_the_fit(light: VIEW) -> None:
    """Within two levels of what it was, in every colour, by gains that are the inverse of what the lamps lost."""
    followed, is_proven = find_light(free_gel(light, 1), free_gel())
    press = np.random.default_rng(2).integers(0, 200, (40, 50, 3)).astype(np.uint8)
    seen = np.clip(np.rint(press * np.array(light)), 0, 255).astype(np.uint8)

    assert is_proven
    assert followed is not None
    assert np.array(followed.gain) == pytest.approx(1 / np.array(light), rel=0.02)
    assert np.abs(followed.restore(seen).astype(int) - press).max() <= 3


def test_the_light_of_the_fit_is_left_alone() -> None:
    """By noise, and by 2 % of a lamp, nothing is changed: scores stay those of the fit, bit for bit."""
    assert find_light(free_gel(seed=1), free_gel()) == (None, True)
    assert find_light(free_gel((0.98, 1.0, 1.02), 1), free_gel()) == (None, True)


@pytest.mark.parametrize(
    ("now", "why"),
    [
        (free_gel((0.9, 0.9, 0.9), 1, tint=12.0), "another gel: its shading is not that of the fit"),
        (free_gel()[:, ::-1].copy(), "another sensor"),
        (free_gel() * np.linspace(0.8, 1, 160, dtype=np.float32)[:, None], "a lamp that fails on one side"),
        (free_gel((0.5, 0.5, 0.5), 1), "half of the light is gone"),
        (np.zeros((120, 160, 3), np.float32), "no light"),
        (free_gel()[:60], "a view of another size"),
        (None, "no free gel was seen"),
    ],
)
def test_what_the_free_gel_does_not_prove_is_not_followed(now: np.ndarray | None, why: str) -> None:
    """Presses are then scored as they are, and the chart of the light says what has changed."""
    assert find_light(now, free_gel()) == (None, False), why
    assert find_light(now, None) == (None, False)


def test_restoring_is_one_line_of_arithmetic_for_each_level() -> None:
    """Worked by hand: 100 becomes 1.25 x 100 + 2 = 127; what would be beyond 255 is 255, and below 0 is 0."""
    light = FollowedLight((1.25, 1.0, 0.5), (2.0, 0.0, -10.0))
    levels = np.array([[[100, 100, 100], [255, 255, 10]]], np.uint8)
    assert light.restore(levels).tolist() == [[[127, 100, 40], [255, 255, 0]]]


def test_all_levels_are_those_of_float64() -> None:
    """The table against the formula, for every level and random lines, exactly."""
    rng = np.random.default_rng(0)
    every = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    for _ in range(20):
        gain, offset = rng.uniform(0.66, 1.5, 3), rng.uniform(-30, 30, 3)
        light = FollowedLight(tuple(gain.tolist()), tuple(offset.tolist()))
        expected = np.clip(np.rint(every.astype(np.float64) * gain + offset), 0, 255)
        assert np.array_equal(light.restore(every), expected)


NEW = free_gel(seed=3, tint=12.0)
"""Another gel, as it was when it was mounted."""


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (0.8, 0.85, 0.8)])
def test_a_press_on_a_new_gel_comes_back_to_the_gel_of_the_fit(light: VIEW) -> None:
    """Within two levels, also where its light has fallen since; what is pressed into it keeps its depth."""
    followed, is_proven = find_light(free_gel(light, 4, tint=12.0), free_gel(), NEW)
    imprint = np.zeros((120, 160, 3), np.float32)
    imprint[50:60, 70:80] = (20, -15, 25)
    seen = np.clip(np.rint((free_gel(seed=5, tint=12.0) + imprint) * np.array(light)), 0, 255).astype(
        np.uint8
    )

    assert is_proven
    assert followed is not None
    off = followed.restore(seen) - (free_gel() + imprint)
    assert np.quantile(np.abs(off), 0.99) < 3.5
    part = Region(60, 40, 50, 40)
    assert np.array_equal(
        part.crop(followed.restore(seen)), followed.restore(part.crop(seen), part, (160, 120))
    )
    assert np.abs(followed.undo(free_gel()) - free_gel(light, 4, tint=12.0)).mean() < 1.5


def test_a_mark_of_a_new_gel_stays() -> None:
    """A cut is not shading: it is seen in every press, and nothing that is pressed there is hidden by it."""
    cut = NEW.copy()
    cut[30:33, 20:60] -= 40
    followed, _ = find_light(cut, free_gel(), cut)
    assert followed is not None
    restored = followed.restore(np.rint(cut).astype(np.uint8)).astype(float)
    assert (restored - free_gel())[30:33, 25:55].mean() < -30


@pytest.mark.parametrize(
    ("new", "why"),
    [
        (free_gel(seed=1)[:, ::-1].copy(), "another kind of sensor: its colours run otherwise"),
        (free_gel(seed=1, tint=60.0), "further from the fit than any unit of this kind"),
        (free_gel(seed=1) + 30 * np.sign(np.sin(np.arange(160)))[:, None].astype(np.float32), "no shading"),
        (np.zeros((120, 160, 3), np.float32), "no light"),
        (NEW[:60], "a view of another size"),
        (None, "it is the first gel of the sensor"),
    ],
)
def test_what_is_no_gel_of_this_kind_is_not_followed(new: np.ndarray | None, why: str) -> None:
    now = NEW if new is None or new.shape != NEW.shape else new
    assert find_light(now, free_gel(), new) == (None, False), why


def test_a_lamp_that_fails_on_a_new_gel_is_not_followed_by_its_shading() -> None:
    """The shading is that of the day on which it was mounted; what comes later shows in score and chart."""
    ramp = np.linspace(0.8, 1, 160, dtype=np.float32)[:, None]
    mounted, failed = find_light(NEW, free_gel(), NEW), find_light(NEW * ramp, free_gel(), NEW)
    assert failed == (mounted[0], False)
