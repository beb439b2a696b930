"""A press under other conditions, and of a smoother object: what changes and what stays."""

import numpy as np
import pytest
from pressed_dome import REGION, Bench

from calibration.fitting.damage.conditions import dim, relight, weaken
from calibration.fitting.damage.imprint import Station
from calibration.fitting.damage.rendering import EditedPress


def waves() -> np.ndarray:
    """A picture (240, 320, 3) with waves on three even colours."""
    rows = 20 * np.sin(np.arange(240) / 4)[:, None, None]
    return np.broadcast_to(np.rint(np.array([120.0, 100.0, 90.0]) + rows), (240, 320, 3)).astype(np.uint8)


def test_another_light_changes_colours_and_keeps_relief() -> None:
    """Each colour is scaled by 0.69 to 1.31 at most, never twice alike, and the waves stay where they are."""
    found = relight(waves(), np.random.default_rng(1)).astype(float)
    share = found / waves()
    assert 0.6 < share.min() < 0.99
    assert share.max() < 1.33
    middle = np.s_[100:140, 130:190, 0]
    assert np.corrcoef(found[middle].ravel(), waves()[middle].ravel())[0, 1] > 0.98


def test_less_exposure_scales_every_level() -> None:
    """A level of 100 is 85 at 0.85 of the exposure."""
    assert np.array_equal(dim(np.full((2, 2, 3), 100, np.uint8), 0.85), np.full((2, 2, 3), 85, np.uint8))


def test_a_fainter_press_is_nearer_to_the_free_gel() -> None:
    """Of a difference of -40 and 20 levels, 0.7 remains; nothing leaves 0 to 255."""
    free = np.array([[[100.0, 100, 250]]], np.float32)
    assert weaken(np.array([[[60, 120, 255]]], np.uint8), free, 0.7).tolist() == [[[72, 114, 254]]]
    assert weaken(np.array([[[60, 120, 255]]], np.uint8), free, 3.0).tolist() == [[[0, 160, 255]]]


@pytest.fixture(scope="module")
def press(station: Station, bench: Bench) -> EditedPress:
    return EditedPress(station, np.ascontiguousarray(REGION.crop(bench.press(0))))


def change(press: EditedPress, sigma_mm: float, where: np.ndarray) -> float:
    """The mean change of a smoother press there, levels."""
    return float(np.abs(press.smooth(sigma_mm).astype(int) - press.rgb)[where].mean())


def test_a_smoother_object_changes_the_contact_alone(press: EditedPress) -> None:
    """Its grooves fade with the window; the free gel around it keeps its grain and its noise."""
    away = press.surface < 0.01
    assert change(press, 0.4, press.contact) > 1.2 * change(press, 0.2, press.contact) > 1
    assert change(press, 0.2, press.contact) > 3 * change(press, 0.2, away)
    assert not np.array_equal(press.smooth(0.2)[press.contact], press.rgb[press.contact])
