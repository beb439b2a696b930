"""How well do heights come back? Balls of known size on real gels, and surfaces that the simulator knows.

    TACTILE=real_tactile pytest -m bench -s tests/bench/test_heights.py

`TACTILE` is a folder with the public frames `rpl-cmu__gelslam`, `skleff1994__gs_sdk` and `FabPrez__Taxim`. Of each ball
the errors are of five folds; on the gelslam gel the balls of one size are also measured by a calibration with the
other alone. Where a ball lies, and so its depth, is found in its picture; its radius was measured with a gauge.
"""

from collections.abc import Sequence

import numpy as np
import pytest
from ball_presses import RADIUS_MM, frames, nominal, renderer
from real_balls import real_balls

from calibration.sensor_fit.ball import Ball, ball_height
from calibration.sensor_fit.heights import HeldBall, calibrate_heights, measure_presses
from calibration.simulator.field_of_view import LR, grids
from edge.core.heights.calibration import HeightCalibration
from edge.core.heights.height_map import measure_heights

_OTHER = {"gelslam, 6.31 mm": "gelslam, 9.50 mm", "gelslam, 9.50 mm": "gelslam, 6.31 mm"}
_HEAD = (
    "\n| balls | calibrated with | n | radius, median, sd | top, mean, sd, mm | places within the uncertainty |\n"
    "|---|---|---|---|---|---|"
)


def row(name: str, by: str, balls: Sequence[HeldBall], radius: float, made: HeightCalibration) -> str:
    """One line of the table."""
    radii = np.array([one.radius_mm for one in balls]) / radius - 1
    tops = np.array([one.height_mm - one.depth_mm for one in balls])
    return (
        f"| {name} | {by} | {len(balls)} | {np.median(radii):+.1%}, {radii.std():.1%} | {tops.mean():+.3f}, "
        f"{tops.std():.3f} | {within(balls, made):.1%} |"
    )


def within(balls: Sequence[HeldBall], made: HeightCalibration) -> float:
    """The share of places inside contact, whose scale is that of the balls, within floor and share of the height."""
    true, error = np.hstack([one.inside_mm for one in balls])
    return float((np.abs(error) <= made.floor_u95_mm + made.height_u95 * true).mean())


@pytest.mark.bench
def test_balls_of_known_size() -> None:
    """The uncertainty covers 95 % of the places in balls that were held out."""
    given = real_balls()
    print(_HEAD)
    for name, (shown, radius) in given.items():
        found = calibrate_heights(shown, "ball", radius, LR.mm_per_px[0])
        print(row(name, "the others, five folds", found.held, radius, found.calibration), flush=True)
        assert within(found.held, found.calibration) >= 0.95
        if (other := _OTHER.get(name)) is not None:
            others, size = given[other]
            balls = measure_presses(found.calibration, others, size)
            print(row(other, f"{name} alone", balls, size, found.calibration), flush=True)


@pytest.mark.bench
def test_surfaces_that_the_simulator_knows() -> None:
    """Balls of 1.5 to 5 mm at 0.1 to 0.5 mm on a gel that balls of 2 mm calibrated: 95 % of the touched
    places are covered."""
    shown = frames()
    made = calibrate_heights(nominal(shown), "simulated", RADIUS_MM, LR.mm_per_px[0]).calibration
    covered: list[float] = []
    print("\n| ball radius, mm | depth, mm | top, error | rms, mm | places within |\n|---|---|---|---|---|")
    for radius in (1.5, 3.0, 5.0):
        for depth in (0.1, 0.2, 0.5):
            height = ball_height(Ball(-2.5, 1.0, depth), radius, *grids(LR))
            rgb = renderer().press(
                lambda _x, _y, height=height: height, 0.0, ("bench", f"{radius:g} {depth:g}")
            )  # type: ignore[misc]
            truth = renderer().surface(renderer().imprint(height, 0.0))
            found = measure_heights(rgb, shown[0], made)
            error = found.heights_mm - truth
            covered.append(float((np.abs(error) <= found.u95_mm)[found.touched].mean()))
            top, rms = (
                found.heights_mm.max() / truth.max() - 1,
                float(np.sqrt((error[found.touched] ** 2).mean())),
            )
            print(f"| {radius:g} | {depth:g} | {top:+.1%} | {rms:.4f} | {covered[-1]:.1%} |", flush=True)
    assert np.mean(covered) >= 0.95
