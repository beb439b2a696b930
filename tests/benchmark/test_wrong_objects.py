"""Presses of wrong objects: dimples, a ball brought to the middle, features made lower."""

import numpy as np
import pytest

from calibration.benchmark.presses import Sizes, development_pictures
from calibration.benchmark.wrong_objects import Case, part_case, placed, with_dimples
from calibration.simulator.random_parts import RandomPart

FREE = np.full((240, 320, 3), 120, np.uint8)


def ball(x: int, y: int, radius: int = 30) -> np.ndarray:
    """A press whose colours run over a disc as those of a ball do."""
    rows, columns = np.mgrid[:240, :320]
    dx, dy = (columns - x) / radius, (rows - y) / radius
    inside = (dx * dx + dy * dy < 1)[..., None]
    return np.clip(FREE + inside * np.stack([60 * dy, 50 * dx, -60 * dy], axis=2), 0, 255).astype(np.uint8)


def middle(rgb: np.ndarray) -> tuple[float, float]:
    rows, columns = np.nonzero(np.abs(rgb.astype(int) - FREE).sum(axis=2) > 20)
    return float(columns.mean()), float(rows.mean())


def test_a_press_is_brought_to_the_middle() -> None:
    """From anywhere in the picture to within five pixels of its middle; the free gel stays."""
    found = placed(ball(100, 150), FREE, np.random.default_rng(0))
    assert found is not None
    assert middle(found) == pytest.approx((160, 120), abs=5)
    assert np.array_equal(found[:40], FREE[:40])


@pytest.mark.parametrize("press", [ball(310, 120), ball(160, 20), FREE])
def test_a_press_that_leaves_the_picture_is_left_out(press: np.ndarray) -> None:
    """Only a part of its contact is known, or none."""
    assert placed(press, FREE, np.random.default_rng(0)) is None


def test_dimples_change_the_contact_alone() -> None:
    """Deeper ones change it more."""
    press = ball(160, 120)
    shallow, deep = (
        np.abs(with_dimples(press, FREE, np.random.default_rng(0), depth_mm=depth).astype(int) - press)
        for depth in (0.02, 0.06)
    )
    assert deep[100:140, 140:180].mean() > 1.5 * shallow[100:140, 140:180].mean() > 0
    assert deep[:60].max() <= 1


FEW = Sizes(pieces=2, held_out=1, presses=2, damaged=0)


def test_a_changed_part_is_pressed_at_the_same_place() -> None:
    """Learnt presses and sound ones of another piece; without its features a part shows less."""
    sound = development_pictures(2, FEW)
    flat = development_pictures(2, FEW, lambda part: RandomPart(part.body, (), part.place))
    assert (len(sound.learnt), len(sound.sound)) == (2, 2)
    assert np.array_equal(sound.free, flat.free)
    relief = [np.abs(one.sound[0].astype(int) - one.free).mean() for one in (sound, flat)]
    assert relief[0] != relief[1]


def test_a_case_names_what_is_sound_and_what_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lighter press and another light are sound; lower features are not."""
    monkeypatch.setattr("calibration.benchmark.presses.Sizes", lambda: FEW)
    case = part_case(2)
    assert isinstance(case, Case)
    assert {"sound", "other light", "pressed 0.7 as deep"} <= case.sound.keys()
    assert {"without its features", "smoothed by 0.19 mm"} <= case.wrong.keys()
    assert all(len(pictures) == 2 for pictures in {**case.sound, **case.wrong}.values())
