"""What banks of one method on one trunk see of damage: the press, and its place."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, dome_config, dome_presses

from calibration.fitting.damage_seen import DamageJudge, PosedPresses, measure_separation
from calibration.fitting.limits.held_out import ScoredPresses
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from edge.core.errors import FitError
from edge.core.registration.pose import Pose, PoseUncertainty, Registered


def scored(maps: np.ndarray) -> ScoredPresses:
    return ScoredPresses(maps.astype(np.float32), maps.max(axis=(1, 2)).astype(np.float64))


@pytest.mark.parametrize(
    ("at", "expected"),
    [(("on",), 1.0), (("off",), 0.5), (("on", "off"), 0.734), ((), 0.25)],
)
def test_what_is_seen_is_half_the_press_and_half_the_place(at: tuple[str, ...], expected: float) -> None:
    """Seen at its place alone 1; found somewhere else a half, for the press; nothing seen a quarter, as by chance."""
    masks = np.zeros((1, 8, 8), np.bool_)
    masks[0, :2, :2] = True
    maps = np.zeros((1, 8, 8), np.float32)
    if "on" in at:
        maps[masks] = 1.0
    if "off" in at:
        maps[0, 7, 7] = 2.0
    found = measure_separation(scored(np.zeros((2, 8, 8))), scored(maps), masks)
    assert found == pytest.approx(expected, abs=0.01)


def registered(right_px: float, refusal: str | None = None) -> Registered:
    """A press that lay so far to the right, its left half learnt."""
    rgb, seen = np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), np.bool_)
    seen[:, :4] = True
    return Registered(rgb, seen, Pose(right_px), PoseUncertainty(0.1, 0.1, None), 0.9, 0.5, refusal=refusal)


def test_a_registered_press_is_judged_as_it_lies() -> None:
    """Its map is brought back to where the part lay, and what no bank knows does not count; one without a pose shows
    nothing."""
    maps = np.zeros((2, 8, 8))
    maps[:, 3, 2], maps[:, 3, 6] = 5.0, 9.0
    presses = gather_presses({"a": np.zeros((240, 320, 3), np.uint8)}, PROFILE, REGION)
    brought = PosedPresses(presses, presses.frames, [registered(3.0), registered(0.0, "no such part")], 4.0)
    found = brought.bring_back(scored(maps))
    assert np.argwhere(found.maps[0] == found.maps[0].max()).tolist() == [[3, 5]]
    assert found.scores.tolist() == [5.0, 0.0]
    assert not found.maps[1].any()
    assert PosedPresses(presses, presses.frames).bring_back(scored(maps)).scores.tolist() == [9.0, 9.0]


@pytest.fixture(scope="module")
def presses() -> NominalPresses:
    """Four presses of a dome."""
    return dome_presses(4)


def test_a_method_that_would_be_refused_is_not_judged(presses: NominalPresses) -> None:
    """Presses that lie apart and are not registered: the fit would refuse a method that compares places."""
    config = dome_config(folds=2)
    apart = tuple(replace(touch, x=0.3 * (k % 4), y=0.2) for k, touch in enumerate(presses.touches))
    judge = DamageJudge(replace(presses, touches=apart), config)
    found = judge.judge(config.trunk, ("layer1",), {"padim": config.detector})
    assert isinstance(found["padim"], FitError)
    assert "half of the contacts lie more than" in str(found["padim"])


def test_many_presses_are_judged_by_some_of_them(presses: NominalPresses) -> None:
    """Evenly spread, each with its name and its touch; few are taken as they are."""
    some = presses.spread(3)
    assert some.names == tuple(presses.names[k] for k in (0, 2, 3))
    assert some.touches == tuple(presses.touches[k] for k in (0, 2, 3))
    assert np.array_equal(some.frames, presses.frames[[0, 2, 3]])
    assert presses.spread(4) is presses
