"""A press is brought to the bank's pose: how exactly, with which uncertainty, and when it is refused."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
import scipy
import turned_parts as parts

from calibration.fitting.pose.registration import LearntPose, learn_pose
from edge.core.registration.colours import FreeLight
from edge.core.registration.pose import Pose, depth_inside
from edge.core.registration.registrar import PoseSearch, Registrar, depth_of, find_relief, shrunk

RIM = Pose(34.0, -4.0, 0.4)


@cache
def learnt(name: str) -> LearntPose:
    """From eight presses anywhere."""
    return learn_pose(parts.anywhere(getattr(parts, name), 8)[1], parts.free_gel())


@cache
def registrar(name: str) -> Registrar:
    return Registrar(learnt(name).part)


def _apart(found: Pose, true: Pose, first: Pose) -> tuple[float, float]:
    """Pixels and degrees between a pose and the true one; first: the bank's own pose."""
    rest = true.after(first).inverse().after(found)
    return math.hypot(rest.x_px, rest.y_px), abs(math.degrees(rest.turn_rad))


def _bank_pose(name: str) -> Pose:
    """Where the bank lies, from the first press, whose true pose is known."""
    true = parts.poses(8)[0]
    return true.inverse().after(learnt(name).registered[0].pose)


def test_a_part_is_found_anywhere_at_any_turn() -> None:
    """Within a fifth of a pixel and of a degree of where the formula put it: 0.013 mm on a Mini."""
    true, presses = parts.anywhere(parts.BLOCK, 12, seed=50)
    found = [registrar("BLOCK").register(rgb) for rgb in presses]
    apart = np.array(
        [_apart(one.pose, pose, _bank_pose("BLOCK")) for one, pose in zip(found, true, strict=True)]
    )

    assert (apart.max(axis=0) < (0.2, 0.2)).all(), apart.max(axis=0)
    assert not any(one.refusal for one in found)


def test_the_uncertainty_is_the_size_of_the_error() -> None:
    """Errors of shift are between a third of the stated deviation and four times it, in the root mean square."""
    true, presses = parts.anywhere(parts.BLOCK, 12, seed=70)
    ratios = []
    for rgb, pose in zip(presses, true, strict=True):
        one = registrar("BLOCK").register(rgb)
        shift, _ = _apart(one.pose, pose, _bank_pose("BLOCK"))
        ratios.append(shift / math.hypot(one.uncertainty.x_px, one.uncertainty.y_px))

    assert 1 / 3 < float(np.sqrt(np.mean(np.square(ratios)))) < 4


@pytest.mark.parametrize(("turn_rad", "ratio"), [(0.0, 3.5), (math.pi / 4, 1.0), (math.pi / 2, 1 / 3.5)])
def test_the_uncertainty_lies_along_a_bar_in_the_press(turn_rad: float, ratio: float) -> None:
    """Only its ends say where a bar lies along itself: along x, or along y where it is pressed at a right angle."""
    everywhere = np.ones((parts.SIDE, parts.SIDE), bool)
    bar = replace(registrar("BLOCK").part, template=parts.press(parts.BAR, noise=0.0), learnt=everywhere)
    found = Registrar(bar).register(parts.press(parts.BAR, Pose(3.0, -2.0, turn_rad))).uncertainty

    assert found.x_px / found.y_px == pytest.approx(ratio, rel=0.1)


def test_the_estimate_is_that_of_an_optimiser_in_float64() -> None:
    """The formula's slopes fitted to a press by Nelder and Mead agree with the search in 0.05 px and 0.1 degrees."""
    true = Pose(5.3, -3.7, 0.8)
    press = parts.slopes(parts.BLOCK, true, 112)
    search = PoseSearch(parts.slopes(parts.BLOCK, Pose(), 112).astype(np.float32))

    def misfit(pose: np.ndarray) -> float:
        return float(((parts.slopes(parts.BLOCK, Pose(*pose), 112) - press) ** 2).sum())

    oracle = Pose(*scipy.optimize.minimize(misfit, [5.0, -4.0, 0.7], method="Nelder-Mead").x.tolist())
    found = search.find(press.astype(np.float32)).pose

    assert _apart(oracle, true, Pose())[0] < 1e-3
    shift, turn = _apart(found, oracle, Pose())
    assert shift < 0.05
    assert turn < 0.1


def test_another_light_moves_nothing() -> None:
    """A press under four fifths of the light lies where it lay."""
    pose = Pose(8.0, -5.0, 1.1)
    bright, dim = (
        registrar("BLOCK").register(parts.press(parts.BLOCK, pose, gain=gain)) for gain in (1.0, 0.8)
    )

    assert _apart(dim.pose, bright.pose, Pose())[0] < 0.3
    assert dim.refusal is None


def test_a_ball_has_no_turn() -> None:
    """It is found by its place alone, and no turn is stated."""
    true, presses = parts.anywhere(parts.BALL, 6, seed=20)
    found = [registrar("BALL").register(rgb) for rgb in presses]
    offsets = np.array(
        [
            (one.pose.x_px - pose.x_px, one.pose.y_px - pose.y_px)
            for one, pose in zip(found, true, strict=True)
        ]
    )

    assert not learnt("BALL").part.is_turning
    assert {one.uncertainty.turn_rad for one in found} == {None}
    assert np.ptp(offsets, axis=0).max() < 0.5


def test_a_symmetric_part_looks_the_same_in_each_of_its_poses() -> None:
    """Which quarter turn is found does not matter: the press in the bank's pose is the mean press."""
    _, presses = parts.anywhere(parts.CROSS, 8, seed=30)
    template = learnt("CROSS").part.template.astype(np.float32)
    for one in (registrar("CROSS").register(rgb) for rgb in presses):
        assert one.refusal is None
        assert np.abs(cv2.blur(one.rgb.astype(np.float32), (3, 3)) - cv2.blur(template, (3, 3))).max() < 12


def test_a_part_at_the_rim_is_found_and_the_rest_is_unseen() -> None:
    """Its place is right although a part of it left the field, and the result states how much. Unseen places count
    neither for the press nor in its map, and show the mean nominal press. Where more of it is wanted it is refused."""
    press = parts.press(parts.BLOCK, RIM, noise=0.0)
    found = registrar("BLOCK").register(press)
    refused = Registrar(replace(registrar("BLOCK").part, least_seen=0.95)).register(press)
    scores = np.where(found.seen, 1.0, 100.0).astype(np.float32)
    away = np.abs(found.rgb.astype(np.float32) - registrar("BLOCK").part.template).max(axis=2)

    assert _apart(found.pose, RIM, _bank_pose("BLOCK"))[0] < 0.5
    assert found.seen_share == refused.seen_share < 0.95
    assert found.refusal is None
    lost = f"{1 - found.seen_share:.0%} of the part lie outside the inspected region, at most 5% are accepted"
    assert str(refused.refusal).startswith(lost)
    assert found.unseen_in_press.any()
    assert (found.score(scores), found.in_press(scores).max()) == (1.0, 1.0)
    assert away[depth_inside(found.pose, (parts.SIDE, parts.SIDE)) < 0].max() <= 1


@pytest.mark.parametrize("part", ["BLOCK", "TEETH"])
def test_a_part_that_is_held_is_found_near_the_pose_of_the_bank(part: str) -> None:
    """There as exactly as anywhere; one that lies elsewhere all the same is looked for anywhere."""
    anywhere = registrar(part)
    held = Registrar(replace(anywhere.part, is_held=True, least_match=0.55))
    lies = _bank_pose(part).inverse()

    for moved in (Pose(3.0, -2.0, 0.03), Pose(-4.0, 3.0, -0.05), Pose(8.0, 2.0, 0.04), Pose(0.0, 0.0, 2.0)):
        press = parts.press(getattr(parts, part), moved.after(lies), seed=5)
        found, other = held.register(press), anywhere.register(press)
        assert _apart(found.pose, other.pose, Pose())[0] < 0.1
        assert found.match == pytest.approx(other.match, abs=0.005)


def test_the_turn_of_a_held_part_is_the_nearest_of_those_that_look_the_same() -> None:
    """So what breaks the symmetry lies at its own place."""
    held = Registrar(replace(registrar("CROSS").part, is_held=True))
    lies = _bank_pose("CROSS").inverse()

    found = [
        held.register(parts.press(parts.CROSS, pose.after(lies), seed=9))
        for pose in parts.poses(6, shift_px=4.0, turn_rad=0.1)
    ]
    assert max(abs(one.pose.turn_rad) for one in found) < 0.15


def held(name: str) -> Registrar:
    """By the part's formula, as a fixture holds it."""
    everywhere = np.ones((parts.SIDE, parts.SIDE), bool)
    template = parts.press(getattr(parts, name), noise=0.0)
    return Registrar(
        replace(registrar("BLOCK").part, template=template, learnt=everywhere, is_held=True, least_seen=0.6)
    )


def test_a_regular_part_half_a_pitch_off_is_found_on_either_side() -> None:
    """So its places are not known, though it lies at one place, within a pixel."""
    presses = [parts.press(parts.GRID, Pose(x, 0.0), seed=9) for x in (11.5, 12.5)]
    left, right = (held("GRID").register(rgb) for rgb in presses)

    assert right.pose.x_px - left.pose.x_px == pytest.approx(-23, abs=1)
    assert (left.refusal, right.refusal) == (None, None)
    assert not left.is_unique


@pytest.mark.parametrize("name", ["BLOCK", "TEETH", "CROSS", "BALL", "GRID", "EDGE"])
def test_which_place_of_a_part_lies_where_is_known_of_no_part_that_repeats_itself(name: str) -> None:
    """A pitch further on, along an edge, or turned; a part that is held keeps its turn."""
    regular = {"GRID", "EDGE"}
    assert held(name).register(parts.press(getattr(parts, name))).is_unique == (name not in regular)
    if name not in regular:
        found = registrar(name).register(parts.press(getattr(parts, name)))
        assert found.is_unique == (name not in {"CROSS", "BALL"})


@pytest.mark.parametrize(("nearly", "thirds"), [(1, 0), (3, 1)])
def test_a_part_that_nearly_repeats_itself_is_turned_by_where_it_does_not(nearly: int, thirds: int) -> None:
    """Of three like teeth the light, which does not turn with them, makes one higher; a low bump beside one of them
    says how they are turned, and in sum it says less."""
    third = 2 * math.pi / 3
    lit, *others = parts.ring(3)

    def turned(turn_rad: float) -> parts.Bumps:
        bump = 10 * math.cos(third + turn_rad), 10 * math.sin(third + turn_rad), 4.0, 1.5
        return ((*lit[:3], 1.2 * lit[3]), *others, bump)

    search = PoseSearch(parts.slopes(turned(0), Pose()).astype(np.float32), nearly=nearly)
    for true in parts.poses(4):
        found = search.find(parts.slopes(turned(third), true).astype(np.float32)).pose
        away_rad = math.remainder(found.turn_rad - true.turn_rad - thirds * third, 2 * math.pi)
        assert abs(away_rad) < 0.1


def test_the_relief_of_a_bump_is_a_disc() -> None:
    """Up to a tenth of its steepest slope, which the formula has at 2.79 radii; its flat top is enclosed."""
    relief = find_relief(parts.slopes(((10.0, -6.0, 12.0, 8.0),), Pose()).astype(np.float32))
    y, x = np.mgrid[: parts.SIDE, : parts.SIDE] - (parts.SIDE - 1) / 2
    radius = np.hypot(x - 10, y + 6)

    assert relief[radius < 2.79 * 12 - 0.5].all()
    assert not relief[radius > 2.79 * 12 + 0.5].any()


@pytest.mark.parametrize("to_end", [True, False])
def test_relief_is_scored_up_to_the_end_of_what_the_press_shows(to_end: bool) -> None:
    """All that shows but two pixels for the interpolation; flat places, and an older bundle, keep a seam of 4 px."""
    part = replace(registrar("BLOCK").part, scores_relief_to_end=to_end)
    found = Registrar(part).register(parts.press(parts.BLOCK, RIM))
    light = FreeLight(part.free)
    relief = (
        find_relief(part.colours.slopes(light.find_change(part.template) * part.learnt[..., None]))
        & part.learnt
    )
    depth = np.minimum(depth_inside(found.pose, (parts.SIDE, parts.SIDE)) - 1, depth_of(part.learnt))

    np.testing.assert_array_equal(found.seen[relief], depth[relief] >= (1 if to_end else 4))
    np.testing.assert_array_equal(found.seen[~relief], depth[~relief] >= 4)
    assert ((depth >= 1) & (depth < 4) & relief).sum() > 20


def test_the_map_comes_back_to_where_the_damage_lies() -> None:
    """A bright place of the bank's map lies at the same place of the part in the press, with the same score."""
    found = registrar("BLOCK").register(parts.press(parts.BLOCK, Pose(10.0, 6.0, 2.0)))
    scores = np.zeros(found.seen.shape, np.float32)
    scores[60, 70] = 5.0
    back = found.in_press(scores)
    row, column = np.unravel_index(int(back.argmax()), back.shape)
    x, y = found.pose.matrix((parts.SIDE, parts.SIDE)) @ [70, 60, 1]

    assert back.max() == 5.0
    assert np.hypot(row - y, column - x) < 1.5


@pytest.mark.parametrize("what", ["free gel", "other part", "flat part"])
def test_what_is_not_the_part_is_refused(what: str) -> None:
    """The free gel, another part, and a part without relief have no pose, and a sentence says so."""
    foreign = {
        "free gel": parts.free_gel(),
        "other part": parts.press(parts.OTHER, Pose(3.0, 2.0, 0.3)),
        "flat part": parts.press(((0.0, 0.0, 60.0, 0.5),)),
    }[what]
    assert "not recognised" in str(registrar("BLOCK").register(foreign).refusal)


def test_a_second_part_does_not_lead_away() -> None:
    """Where another small part lies next to the learnt one, the learnt one is found, or the press is refused."""
    true = Pose(-6.0, 4.0, 0.9)
    beside = tuple((x / 3 + 38, y / 3 - 38, radius / 2, height / 2) for x, y, radius, height in parts.OTHER)
    both = parts.slopes(parts.BLOCK, true) + parts.slopes(beside, Pose())
    added = registrar("BLOCK").light.find_change(parts.press(parts.BLOCK, true))
    rgb = registrar("BLOCK").light.picture((added * 0 + both @ parts.SENSOR.T).astype(np.float32))
    found = registrar("BLOCK").register(rgb)

    assert found.refusal or _apart(found.pose, true, _bank_pose("BLOCK"))[0] < 1.0


def test_a_dark_spot_beside_the_part_does_not_lead_away() -> None:
    """It is steeper than the part, and tells nothing of where it lies."""
    true = Pose(-6.0, 4.0, 0.9)
    rgb = parts.press(parts.BLOCK, true)
    cv2.circle(rgb, (100, 100), 6, (0, 0, 0), -1)
    found = registrar("BLOCK").register(rgb)

    assert found.refusal is None
    assert _apart(found.pose, true, _bank_pose("BLOCK"))[0] < 1.0


def dotted(rgb: np.ndarray) -> np.ndarray:
    """As a marker gel shows it: its dots are on the free gel too, and stay where they are."""
    dots = np.ones((parts.SIDE, parts.SIDE, 1), np.float32)
    for row in range(10, parts.SIDE, 18):
        for column in range(10, parts.SIDE, 18):
            cv2.circle(dots, (column, row), 2, 0.4, -1)
    return np.rint(rgb * dots).astype(np.uint8)


@pytest.mark.parametrize(
    ("shape", "shown", "options"),
    [(parts.BLOCK, dotted, {}), (parts.TEETH, np.asarray, {"seed": 5, "shift_px": 14.0})],
    ids=["marker dots", "nine equal teeth, of which one end is marked"],
)
def test_neither_dots_nor_a_pitch_lead_away(shape: parts.Bumps, shown: Any, options: dict[str, Any]) -> None:
    """Every press is found within a pixel of its own place."""
    true, presses = parts.anywhere(shape, 12, **options)
    part = learn_pose(np.stack([shown(rgb) for rgb in presses]), shown(parts.free_gel()))
    first = true[0].inverse().after(part.registered[0].pose)
    assert max(_apart(one.pose, at, first)[0] for one, at in zip(part.registered, true, strict=True)) < 1.0


def test_a_press_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(128, 128, 3\), found uint8 \(64, 64, 3\)"):
        registrar("BLOCK").register(np.zeros((64, 64, 3), np.uint8))


def test_the_bank_lies_in_the_middle_of_the_presses() -> None:
    """Where most presses lie to the right, the bank does too, so that most of what they show is learnt."""
    right = [Pose(20.0, y, 0.2) for y in (-3.0, 0.0, 2.0, 4.0)]
    presses = np.stack([parts.press(parts.BLOCK, pose) for pose in (Pose(), Pose(1.0, 1.0), *right)])
    found = learn_pose(presses, parts.free_gel()).registered

    assert abs(float(np.median([one.pose.inverse().x_px for one in found]))) < 5


def test_a_picture_is_shrunk_to_its_longer_side() -> None:
    """A search at full size finds the same, and takes many times as long; a smaller one stays."""
    sizes = ((120, 160), (160, 120), (60, 80))
    shapes = [shrunk(np.zeros((*size, 2), np.float32), 80).shape for size in sizes]
    assert shapes == [(60, 80, 2), (80, 60, 2), (60, 80, 2)]
