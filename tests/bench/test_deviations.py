"""How well do size and depth of a deviation come back? Damage that the simulator knows, on parts of other shapes.

    TACTILE=real_tactile pytest -m bench -s tests/bench/test_deviations.py

Truth is the gel's surface over the damaged part less that over the sound part in the same pose. Good presses differ in
depth, `shift` in place as well, as parts in a fixture do. Another seed and other parts chose the constants of
`edge.core.heights.deviation`.
"""

import time

import cv2
import numpy as np
import pytest
from ball_presses import RADIUS_MM, frames, nominal, renderer
from real_balls import real_balls

from calibration.sensor_fit.ball import Ball, ball_height
from calibration.sensor_fit.heights import calibrate_heights, measure_presses
from calibration.simulator.defects import place_defect
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import HeightField, Pose
from calibration.simulator.random_parts import random_part
from edge.core.arrays import F64, U8, Mask
from edge.core.defects import Deviation, longest_extent
from edge.core.heights.calibration import HeightCalibration
from edge.core.heights.deviation import measure_deviation
from edge.core.heights.height_map import measure_heights, part_heights

KINDS = ("dent", "burr", "scratch", "material_loss", "impact_mark")
_PARTS, _GOOD, _DEPTH_MM = 8, 2, 0.4


def dilate(places: Mask, px: int) -> Mask:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * px + 1, 2 * px + 1))
    return np.asarray(cv2.dilate(places.astype(np.uint8), kernel) > 0)


def largest(places: Mask) -> Mask:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(places.astype(np.uint8))
    return np.asarray(labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()))


def true_values(change: F64, places: Mask) -> tuple[float, float]:
    """Return depth and size of what a surface shows at these places, mm, as `Deviation` defines them."""
    peak = int(np.where(places, np.abs(change), -1.0).argmax())
    depth = float(change.flat[peak])
    above = dilate(places, 20) & (change * np.sign(depth) >= abs(depth) / 2)
    labels = cv2.connectedComponents(above.astype(np.uint8))[1]
    return -depth, longest_extent(labels == labels.flat[peak]) * LR.mm_per_px[0]


def measure(
    made: HeightCalibration, part: HeightField, depth_mm: float, shift_mm: float, rng: np.random.Generator
) -> list[tuple[str, float, float, Deviation]]:
    """Return each damage: kind, true depth, true size, what was measured."""
    one = renderer()
    free = one.free_gel().astype(np.float32)

    def heights(rgb: U8) -> F64:
        return part_heights(rgb.astype(np.float32) - free, made, np.ones(3))

    good = []
    for number in range(_GOOD):
        pose = Pose(tuple(rng.normal(0, shift_mm, 2).tolist()))  # type: ignore[arg-type]
        rgb = one.press(part, depth_mm * (1 + 0.05 * rng.normal()), ("good", number), pose)
        good.append(heights(rgb))
    rows = []
    for kind in KINDS:
        for severity in (0.3, 0.6, 1.0):
            defect = place_defect(kind, severity, part, depth_mm, rng)
            rgb, mask = one.damage(part, defect, depth_mm, (kind, f"{severity:g}"))
            if not mask.any():
                continue
            places = dilate(largest(dilate(mask, 5)), 2)
            sound, damaged = one.imprints(part, defect, depth_mm, Pose())
            truth = true_values((damaged - sound).astype(np.float64), places)
            found = measure_deviation(heights(rgb), good, places, ~dilate(mask, 3), made)
            rows.append((kind, *truth, found))
    return rows


@pytest.mark.bench
@pytest.mark.parametrize("shift_mm", [0.0, 0.1])
def test_damage_that_the_simulator_knows(shift_mm: float) -> None:
    """95 % of depths and of sizes that are given lie within what is stated of them."""
    shown, rng = frames(), np.random.default_rng(31)
    made = calibrate_heights(nominal(shown), "simulated", RADIUS_MM, LR.mm_per_px[0]).calibration
    parts = [random_part(rng, (4.0, 4.0)) for _ in range(_PARTS)] + [PARTS["PZ1"].positions["pos2"]]
    rows = [row for part in parts for row in measure(made, part, _DEPTH_MM, shift_mm, rng)]
    print(f"\nshift {shift_mm} mm, {len(rows)} deviations")
    print(
        "| kind | n | depth told | depth, median error | within | size told | size, median error, mm | within |"
    )
    print("|---|---|---|---|---|---|---|---|")
    within: list[list[bool]] = [[], []]
    for kind in (*KINDS, "all"):
        of = [row for row in rows if kind in (row[0], "all")]
        depths = [(d.depth_mm, t, d.depth_u95_mm or 0.0) for _, t, _, d in of if d.depth_mm is not None]
        sizes = [(d.size_mm, t, d.size_u95_mm or 0.0) for _, _, t, d in of if d.size_mm is not None]
        within = [[abs(v - t) <= u for v, t, u in values] for values in (depths, sizes)]
        errors = [v / t - 1 for v, t, _ in depths], [v - t for v, t, _ in sizes]
        depth, size = (f"{np.median(one):+.2f}" if one else "" for one in errors)
        shares = [f"{np.mean(one):.0%}" if one else "" for one in within]
        print(
            f"| {kind} | {len(of)} | {len(depths)} | {depth} | {shares[0]} | {len(sizes)} | {size} | {shares[1]} |"
        )
    assert min(np.mean(one) for one in within) >= 0.95


def cut(heights: F64, at_mm: tuple[float, float]) -> F64:
    """Return what lies within 4 mm of a place, which is then the middle; NaN beyond the picture."""
    reach = round(4 / LR.mm_per_px[0])
    x, y = (round(mm / LR.mm_per_px[0] + n / 2 - 0.5) for mm, n in zip(at_mm, LR.size, strict=True))
    framed = np.pad(heights, reach, constant_values=np.nan)
    return framed[y : y + 2 * reach + 1, x : x + 2 * reach + 1]


@pytest.mark.bench
@pytest.mark.parametrize("by", ["gelslam, 6.31 mm", "gelslam, 9.50 mm"])
def test_a_ball_that_is_another_one(by: str) -> None:
    """On a real gel, heights by the balls of one size alone. A good part is a ball, or nothing; the press is a ball of
    the other size, whose middle lies there; against a ball the deviation is a ring as large as the contact. 95 % of the
    depths and of the sizes that are given lie within what is stated."""
    sets = real_balls("gelslam, 6.31 mm", "gelslam, 9.50 mm")
    made = calibrate_heights(*sets[by][:1], by, sets[by][1], LR.mm_per_px[0]).calibration
    balls = list[tuple[str, F64, F64]]()
    middle = cut(np.zeros(LR.shape), (0, 0))
    x, y = (one.astype(np.float32) for one in np.meshgrid(*[np.linspace(-4, 4, len(middle))] * 2))
    for name, (shown, radius) in sets.items():
        assert shown.no_contact is not None
        free = np.rint(shown.no_contact.mean(axis=0)).astype(np.uint8)
        for ball in measure_presses(made, shown, radius):
            rgb = shown.frames[shown.names.index(ball.name)]
            seen = measure_heights(rgb, free, made).heights_mm.astype(np.float64)
            truth = ball_height(Ball(0, 0, ball.depth_mm), radius, x, y).astype(np.float64)
            balls.append((name, cut(seen, (ball.x_mm, ball.y_mm)), truth))
    pairs = [(good, press) for good in balls if good[0] == by for press in balls if press[0] != by]
    nothing = [(("nothing", middle, np.zeros(middle.shape)), press) for press in balls if press[0] != by]
    for kind, of in (("nothing", nothing), (by, pairs)):
        rows = []
        for (_, good, sound), (_, press, damaged) in of:
            change = damaged - sound
            places = np.abs(change) > np.abs(change).max() / 2
            found = measure_deviation(press, [good], places, ~dilate(places, 3), made)
            rows.append((*true_values(change, places), found))
        assert say(f"a ball that is not that of {by}, good: {kind}", rows) >= 0.95


def say(what: str, rows: list[tuple[float, float, Deviation]]) -> float:
    """Print how depths and sizes came back; return the smaller share within what is stated."""
    depths = [(d.depth_mm, t, d.depth_u95_mm or 0.0) for t, _, d in rows if d.depth_mm is not None]
    sizes = [(d.size_mm, t, d.size_u95_mm or 0.0) for _, t, d in rows if d.size_mm is not None]
    print(f"\n{what}: {len(rows)} deviations")
    shares = []
    for name, values in (("depth", depths), ("size", sizes)):
        seen, true, u95 = np.array(values).T
        error = seen - true
        shares.append(float(np.mean(np.abs(error) <= u95)))
        print(
            f"{name}: {len(values)} told, true {true.min():.2f} to {true.max():.2f} mm, error median "
            f"{np.median(error):+.3f}, sd {error.std():.3f}, stated {np.median(u95):.3f}, within {shares[-1]:.0%}"
        )
    return min(shares)


@pytest.mark.bench
def test_time_of_one_press() -> None:
    """Processor time beside the verdict: heights of the press, and one deviation."""
    one, shown = renderer(), frames()
    made = calibrate_heights(nominal(shown), "simulated", RADIUS_MM, LR.mm_per_px[0]).calibration
    press = (one.press(PARTS["PZ2"].positions["pos1"], 0.4) - one.free_gel().astype(np.float32)).astype(
        np.float32
    )
    places = np.zeros((240, 320), np.bool_)
    places[110:130, 150:170] = True
    begun = time.process_time()
    heights = part_heights(press, made, np.ones(3))
    middle = time.process_time()
    measure_deviation(heights, [heights * 1.01, heights], places, ~places, made)
    print(
        f"\nheights {1e3 * (middle - begun):.0f} ms, a deviation {1e3 * (time.process_time() - middle):.0f} ms"
    )
