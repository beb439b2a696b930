"""Parts as height maps, and damage that grows from nothing."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.simulator.defects import DEFECTS, Damaged, Defect, place_defect
from calibration.simulator.field_of_view import LR, Field
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.pose import Pose, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import Renderer

COARSE = Field((160, 120), (0.127, 0.127))
EVERY = [(part.name, position) for part in PARTS.values() for position in part.positions]


@pytest.mark.parametrize(("name", "position"), EVERY)
def test_a_part_tops_out_at_zero_and_is_touched(name: str, position: str) -> None:
    """Its highest point is 0 within 30 micrometres, it is finite float32, and 2 to 70 % of the view is touched."""
    height = sample(PARTS[name].positions[position], Pose(), LR)
    assert height.dtype == np.float32
    assert np.isfinite(height).all()
    assert -0.03 < height.max() <= 1e-6
    assert 0.02 < (height > -PARTS[name].depth_mm).mean() < 0.7


def test_the_threads_pitch_is_one_and_a_half_millimetres() -> None:
    """Along the axis the crests come every 1.5 mm."""
    y = np.linspace(-4, 6, 4001, dtype=np.float32)
    height = PARTS["PZ1"].positions["pos1"](np.zeros_like(y), y)
    crests = y[1:-1][(height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])]
    groups = crests[np.concatenate([[True], np.diff(crests) > 0.3])]
    assert np.allclose(np.diff(groups), 1.5, atol=0.02)


def test_the_threads_positions_are_quarter_turns() -> None:
    """A quarter turn moves the crests by a quarter of the pitch: pos2 is pos1 shifted, away from the chamfer."""
    y = np.linspace(-2, 5, 500, dtype=np.float32)
    zero = np.zeros_like(y)
    first, second = (PARTS["PZ1"].positions[p] for p in ("pos1", "pos2"))
    assert np.allclose(second(zero, y), first(zero, y + np.float32(0.375)), atol=2e-3)


def test_small_parts_are_under_a_centimetre() -> None:
    """PZ4 and PZ5 leave the gel's border free."""
    for name in ("PZ4", "PZ5"):
        touched = sample(PARTS[name].positions["pos1"], Pose(), LR) > -1
        rows, columns = np.nonzero(touched)
        assert (np.ptp(columns) + 1) * 0.0634 < 10
        assert (np.ptp(rows) + 1) * 0.0634 < 10


def test_pieces_of_a_part_differ_within_tolerance() -> None:
    """Two specimens are not equal, and neither is more than 30 micrometres off at the contact."""
    nominal = PARTS["PZ2"].positions["pos1"]
    one, two = (sample(specimen(nominal, np.random.default_rng(k)), Pose(), COARSE) for k in (1, 2))
    sound = sample(nominal, Pose(), COARSE)
    flat = sound > -0.01
    assert not np.array_equal(one, two)
    assert np.median(np.abs(one - sound)[flat]) < 0.03


@pytest.mark.parametrize("kind", DEFECTS)
def test_a_defect_of_no_severity_changes_nothing(kind: str) -> None:
    """Severity 0 gives the sound part's numbers exactly."""
    sound = PARTS["PZ1"].positions["pos1"]
    harmless = Defect(kind, 0.0, (0.0, 1.0))
    assert np.array_equal(sample(Damaged(sound, harmless), Pose(), COARSE), sample(sound, Pose(), COARSE))


@pytest.mark.parametrize("kind", DEFECTS)
def test_a_defect_grows_with_its_severity(kind: str) -> None:
    """On a thread and on grooves, more severity never changes the part less, and full severity is marked."""
    for name in ("PZ1", "PZ3"):
        sound, depth = PARTS[name].positions["pos1"], PARTS[name].depth_mm
        spot = place_defect(kind, 1.0, sound, depth, np.random.default_rng(4))
        look = Renderer(LR, ("deformation",))
        changes, areas = [], []
        for severity in (0.05, 0.3, 0.6, 1.0):
            clean, damaged = look.imprints(sound, replace(spot, severity=severity), depth, Pose())
            changes.append(float(np.abs(damaged - clean).sum()))
            areas.append(int(look.mask(clean, damaged).sum()))
        assert changes == sorted(changes)
        assert areas[-1] >= 20
        assert areas[0] < areas[-1]


def test_a_defect_stays_where_it_was_put() -> None:
    """Three millimetres away the part is untouched, whatever the kind."""
    sound = PARTS["PZ3"].positions["pos1"]
    for kind in DEFECTS:
        at = (-3.0, -2.0)
        change = sample(Damaged(sound, Defect(kind, 1.0, at, 0.4)), Pose(), LR) - sample(sound, Pose(), LR)
        rows, columns = np.nonzero(np.abs(change) > 1e-3)
        x, y = (columns - 159.5) * 0.0634 - at[0], (rows - 119.5) * 0.0634 - at[1]
        assert rows.size
        assert np.hypot(x, y).max() < 3.0


def test_a_burr_only_adds_and_a_loss_only_takes() -> None:
    """The signs of damage: a burr is higher, a chip, a flat and a scratch are lower."""
    sound = PARTS["PZ2"].positions["pos1"]
    base = sample(sound, Pose(), COARSE)

    def change(kind: str) -> np.ndarray:
        return sample(Damaged(sound, Defect(kind, 1.0, (5.7, 0.0))), Pose(), COARSE) - base

    assert change("burr").min() >= 0 < change("burr").max()
    for kind in ("material_loss", "flattened_crest", "abrasion"):
        assert change(kind).max() <= 1e-6 > change(kind).min()


def test_defects_are_placed_where_the_press_touches_and_the_detector_looks() -> None:
    """A hundred spots: all in the inspected square, all within half the press's depth."""
    rng = np.random.default_rng(0)
    sound, depth = PARTS["PZ3"].positions["pos1"], PARTS["PZ3"].depth_mm
    for _ in range(100):
        x, y = place_defect("dent", 0.5, sound, depth, rng).at_mm
        assert max(abs(x), abs(y)) < 7.1 - 0.5
        assert sound(np.full((1, 1), x, np.float32), np.full((1, 1), y, np.float32)) > -0.6 * depth


@pytest.mark.parametrize(
    ("change", "found"),
    [({"kind": "rust"}, "found 'rust'"), ({"severity": 1.2}, "found 1.2"), ({"size": 0.0}, "found 0.0")],
)
def test_a_nonsensical_defect_is_refused(change: dict[str, object], found: str) -> None:
    good: dict[str, object] = {"kind": "dent", "severity": 0.5, "at_mm": (0.0, 0.0)}
    with pytest.raises(ValueError, match=found):
        Defect(**{**good, **change})  # type: ignore[arg-type]


def test_a_press_that_touches_nothing_cannot_be_damaged() -> None:
    """Placing needs contact; without contact it is refused."""
    nothing = lambda x, y: np.full_like(x, -3)  # noqa: E731
    with pytest.raises(ValueError, match="touches nothing"):
        place_defect("dent", 1.0, nothing, 0.4, np.random.default_rng(0))


def test_random_parts_are_sound_and_different() -> None:
    """Sixty parts: finite, at most 0 high, mostly touched by a press, and no two alike."""
    touched, seen = 0, set()
    for k in range(60):
        height = sample(random_part(np.random.default_rng(k)), Pose(), COARSE)
        assert np.isfinite(height).all()
        assert height.max() <= 0
        touched += bool((height > -0.4).mean() > 0.005)
        seen.add(height.tobytes())
    assert touched >= 50
    assert len(seen) == 60


def test_random_parts_are_none_of_the_five() -> None:
    """No random imprint correlates with an analogue's above 0.8, over 80 parts and every position."""
    shape = Field((80, 60), (0.254, 0.254))
    analogues = [
        np.maximum(sample(PARTS[name].positions[position], Pose(), shape), -0.5).ravel()
        for name, position in EVERY
    ]
    worst = 0.0
    for k in range(80):
        one = np.maximum(sample(random_part(np.random.default_rng(k)), Pose(), shape), -0.5).ravel()
        if one.std() > 1e-3:
            worst = max(worst, *(float(np.corrcoef(one, other)[0, 1]) for other in analogues))
    assert worst < 0.8
