"""Size and depth of a deviation of known shape, and every case in which nothing may be claimed."""

from dataclasses import replace

import numpy as np
import pytest
from lit_surface import MM_PER_PX, calibration, grid

from edge.core.arrays import F64, Mask
from edge.core.defects import Deviation
from edge.core.heights.deviation import measure_deviation


def dome() -> F64:
    """A good part: 0.5 mm high in the middle."""
    x, y = grid()
    return 0.5 * np.exp(-(x * x + y * y) / 40)


def dent(at_mm: tuple[float, float], depth_mm: float, width_mm: float) -> F64:
    """Half of its depth is `width_mm` wide."""
    x, y = grid()
    away = np.hypot(x - at_mm[0], y - at_mm[1])
    return depth_mm * 0.5 ** ((2 * away / width_mm) ** 2)


def disc(at_mm: tuple[float, float], radius_mm: float) -> Mask:
    x, y = grid()
    return np.asarray(np.hypot(x - at_mm[0], y - at_mm[1]) < radius_mm)


def deeper() -> F64:
    """How a second press of the same part differs: deeper, and tilted."""
    x, y = grid()
    return 0.08 + 0.01 * x - 0.006 * y


def rough() -> F64:
    """What good presses differ by: waves of 0.03 mm."""
    x, y = grid()
    return 0.03 * np.sin(6 * x) * np.sin(5 * y)


def measure(press: F64, places: Mask, good: tuple[F64, ...] = (), sound: Mask | None = None) -> Deviation:
    return measure_deviation(
        press, good or (dome(),), places, ~places if sound is None else sound, calibration()
    )


@pytest.mark.parametrize("at_mm", [(0.0, 0.0), (-4.0, 3.0), (9.6, 0.0), (-10.0, -7.4)])
@pytest.mark.parametrize("depth_mm", [0.2, -0.2, 0.05])
@pytest.mark.parametrize("width_mm", [0.8, 1.5])
def test_depth_and_size_come_back(at_mm: tuple[float, float], depth_mm: float, width_mm: float) -> None:
    """In the middle, and at the border and in the corner of the view; a bump is a negative depth. The depth within a
    twentieth, for the dent reaches a little into what is around it, in the corner within what is stated; the size
    within two pixels."""
    press = dome() + deeper() - dent(at_mm, depth_mm, width_mm)
    found = measure(press, disc(at_mm, 0.7 * width_mm))
    assert found.depth_mm == pytest.approx(depth_mm, abs=found.depth_u95_mm)
    if max(map(abs, at_mm)) < 9:
        assert found.depth_mm == pytest.approx(depth_mm, rel=0.05)
        assert found.size_mm == pytest.approx(width_mm, abs=2 * MM_PER_PX)
    assert 0 < (found.depth_u95_mm or 0) < abs(depth_mm)


def test_the_good_press_that_fits_best_is_taken() -> None:
    """The other one lay elsewhere, and would be taken for a deviation itself."""
    good, places = dome() + rough(), disc((0.0, 0.0), 0.8)
    press, shifted = good - dent((0.0, 0.0), 0.2, 1.0), np.roll(good, 8, axis=1)
    assert measure(press, places, (shifted, good)) == measure(press, places, (good,))
    assert measure(press, places, (shifted,)) != measure(press, places, (good,))


def test_a_narrow_deviation_may_be_deeper() -> None:
    """Of a scratch the gel shows a part: the uncertainty exceeds what is seen of its depth."""
    x, _ = grid()
    scratch = 0.1 * np.exp(-((x / 0.09) ** 2)) * disc((0.0, 0.0), 1.0)
    found = measure(dome() - scratch, disc((0.0, 0.0), 1.0))
    assert "may be deeper and shorter" in found.remark
    assert (found.depth_u95_mm or 0) > 0.05
    assert found.size_mm is None


@pytest.mark.parametrize("error", [0.0, 1.1])
def test_a_ring_that_is_told_too_deep_on_one_side_is_no_arc(error: float) -> None:
    """Heights that are wrong by a share that the calibration allows: an arc is above half of the deepest, and the ring,
    2.9 mm wide, must lie within what is stated."""
    x, y = grid()
    side = np.exp(-((np.arctan2(y, x) / 0.8) ** 2))
    ring = 0.2 * 0.5 ** ((2 * (np.hypot(x, y) - 1.2) / 0.5) ** 2) * (1 + error * side)
    unsure, places = replace(calibration(), height_u95=error / (1 + error)), disc((0.0, 0.0), 1.6)
    found = measure_deviation(dome() - ring, [dome()], places, ~places, unsure)
    assert found.size_mm == pytest.approx(2.9, abs=found.size_u95_mm)
    assert (found.size_u95_mm or 9) < (1.3 if error else 0.3)


SPOT = disc((0.0, 0.0), 0.6)
NOTHING, EVERYTHING = np.zeros_like(SPOT), np.ones_like(SPOT)


@pytest.mark.parametrize(
    ("press", "places", "sound", "remark"),
    [
        (dome(), NOTHING, None, "it has no place in the picture"),
        (dome(), EVERYTHING, None, "too little around it"),
        (dome(), SPOT, NOTHING, "too little around it"),
        (np.full_like(dome(), np.nan), SPOT, None, "too little around it"),
        (np.where(SPOT | disc((0.0, 0.0), 1.2), np.nan, dome()), SPOT, None, "no good press"),
        (dome(), SPOT, None, "what shows of its depth is within 0 mm"),
        (dome() + rough() - dent((0.0, 0.0), 0.002, 1.0), SPOT, None, "what shows of its depth"),
    ],
    ids=["empty", "whole field", "masked", "unseen", "unseen there", "no change", "below noise"],
)
def test_what_is_not_known_is_not_claimed(press: F64, places: Mask, sound: Mask | None, remark: str) -> None:
    found = measure(press, places, sound=sound)
    assert (found.depth_mm, found.size_mm, found.size_u95_mm) == (None, None, None)
    assert found.remark.startswith(remark), found.remark


def test_half_unseen_is_measured_by_what_is_seen() -> None:
    """NaN on one side of the view, where the part lies beyond what a good press shows."""
    x, _ = grid()
    press = np.where(x > 0.9, np.nan, dome() - dent((0.0, 0.0), 0.2, 0.8))
    found = measure(press, disc((0.0, 0.0), 0.6))
    assert found.depth_mm == pytest.approx(0.2, rel=0.05)


def test_a_size_that_is_hardly_told_from_what_is_around_is_not_claimed() -> None:
    """Waves of 0.03 mm around a dent of 0.05 mm: its depth is seen, and not where it ends."""
    found = measure(dome() + rough() - dent((0.0, 0.0), 0.05, 1.5), disc((0.0, 0.0), 1.05))
    assert found.remark.startswith("its outline is not told")
    assert found.depth_mm == pytest.approx(0.05, abs=found.depth_u95_mm)
    assert found.size_mm is None
