"""Heights calibrated for a real sensor: how its colours answer a surface, and how well held-out balls come back.

The response is fitted forwards, colours from slopes, for a fit of slopes from noisy colours makes slopes too small.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.sensor_fit.ball import ball_height
from calibration.sensor_fit.calibrate import divide
from calibration.sensor_fit.fit import BallPress, SensorFit, fit_gel, fit_poses, fit_response
from calibration.sensor_fit.presses import ball_presses, check_ball, untouched_gel
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.gel import deformation
from edge.core.arrays import F32, F64, U8
from edge.core.detector import Progress
from edge.core.errors import FitError, HeightError
from edge.core.heights.calibration import (
    CELLS,
    MAKERS_SCALE_U95,
    MEASURED_SCALE_U95,
    HeightCalibration,
    place_powers,
    surface_terms,
)
from edge.core.heights.height_map import HeightMap, measure_heights
from edge.core.heights.roughness import CUT_OFFS_MM, band
from edge.core.imaging.sensor_check import colour_cells

__all__ = ["CalibratedHeights", "HeldBall", "calibrate_heights", "measure_presses"]

_FOLDS = 5
# Shares of the mean diagonal that are added to the normal equations, as in the simulator's fit.
_RIDGE = 1e-4
# Errors within one ball are alike, so some twenty balls tell little of the tail: what covered 95 % of their own places
# covered 94.1 % of those in balls of another size.
_COVERED = 0.975
# Balls by which heights are scaled, and places in each of which the error is kept.
_SCALED_BY, _PLACES = 10, 200


@dataclass(frozen=True)
class HeldBall:
    """One ball that the response was not fitted to. Everything in mm, except the name."""

    name: str
    x_mm: float
    y_mm: float
    radius_mm: float
    """Of the sphere through the heights inside contact."""
    depth_mm: float
    """How far the ball stands above the free gel, by the place and size of its picture."""
    height_mm: float
    """The top of that sphere."""
    inside_mm: F64
    """float64 (2, n), true heights and their errors at places inside contact."""
    outside_mm: float
    """95 % of the absolute heights of the free gel."""
    ratio: float
    """Measured heights over true ones inside contact, least squares."""
    noise_mm: float
    """Standard deviation of the heights of the free gel, of the waves of roughness."""


@dataclass(frozen=True)
class CalibratedHeights:
    """The calibration, every ball held out, and the presses left out with the reason."""

    calibration: HeightCalibration
    held: tuple[HeldBall, ...]
    left_out: dict[str, str]


def calibrate_heights(
    presses: NominalPresses,
    name: str,
    ball_radius_mm: float,
    mm_per_px: float | None = None,
    serial: str | None = None,
    progress: Progress | None = None,
) -> CalibratedHeights:
    """Calibrate heights with presses of one ball, frames uint8 (n, 240, 320, 3) with a free gel.

    mm_per_px: measured; None for the maker's, which may be wrong by 8 %. Errors: FitError as `ball_presses` and
    `untouched_gel`, and for balls of which none can be measured.
    """
    scale = mm_per_px or LR.mm_per_px[0]
    # The simulator's view has the maker's scale: a sensor of another one is fitted in millimetres of that view.
    radius = ball_radius_mm * LR.mm_per_px[0] / scale
    check_ball(radius)
    free, dots = untouched_gel(presses)
    if dots.any():
        raise FitError(
            "the gel has marker dots, which hide slopes; calibrate heights with a gel without markers"
        )
    usable, left_out = ball_presses(presses, free, dots, radius)
    fit = _place_balls(usable, free, radius, progress)
    free_rgb = np.rint(free.transpose(1, 2, 0)).astype(np.uint8)
    draft = HeightCalibration(
        name=name,
        response=np.zeros((3, 6, 6)),
        rest=np.eye(3),
        free_levels=colour_cells(free_rgb, CELLS),
        mm_per_px=LR.mm_per_px[0],
        scale_u95=MAKERS_SCALE_U95 if mm_per_px is None else MEASURED_SCALE_U95,
        floor_u95_mm=0.0,
        height_u95=0.0,
        noise_mm=0.0,
        serial=serial,
    )
    held = [
        ball
        for fold in range(min(_FOLDS, len(usable)))
        for ball in _hold_out(draft, fit, usable, free_rgb, fold)
    ]
    made = _with_errors(_fit(draft, fit, usable, free_rgb), held)
    factor = scale / LR.mm_per_px[0]
    return CalibratedHeights(_scale(made, factor), tuple(_in_mm(press, factor) for press in held), left_out)


def measure_presses(
    made: HeightCalibration, presses: NominalPresses, ball_radius_mm: float
) -> list[HeldBall]:
    """Measure balls by a calibration made with others, of the maker's scale. Errors: as `calibrate_heights`."""
    free, dots = untouched_gel(presses)
    usable, _ = ball_presses(presses, free, dots, ball_radius_mm)
    fit = _place_balls(usable, free, ball_radius_mm, None)
    free_rgb = np.rint(free.transpose(1, 2, 0)).astype(np.uint8)
    balls = [_measure(made, fit, press, free_rgb) for press in usable]
    return [ball for ball in balls if ball is not None]


def _place_balls(
    presses: Sequence[BallPress], free: F32, radius: float, progress: Progress | None
) -> SensorFit:
    """Find where every ball lies, by the simulator's fit of colours and gel."""
    fitted, others = divide(presses)
    fit = fit_gel(fit_response(fitted, free, radius), fitted, progress)
    fit_poses(fit, others, _FOLDS)
    return fit


def _hold_out(
    draft: HeightCalibration, fit: SensorFit, presses: Sequence[BallPress], free_rgb: U8, fold: int
) -> list[HeldBall]:
    """Measure the balls of one fold by a response that was fitted to the others."""
    made = _fit(draft, fit, [press for k, press in enumerate(presses) if k % _FOLDS != fold], free_rgb)
    held = [_measure(made, fit, press, free_rgb) for press in presses[fold::_FOLDS]]
    return [press for press in held if press is not None]


def _fit(
    draft: HeightCalibration, fit: SensorFit, presses: Sequence[BallPress], free_rgb: U8
) -> HeightCalibration:
    """Fit the response, and scale slopes so that heights of these balls come back as high as they are."""
    made = _solve(draft, fit, presses)
    some = presses[:: -(-len(presses) // _SCALED_BY)]
    ratios = [one.ratio for press in some if (one := _measure(made, fit, press, free_rgb)) is not None]
    if not ratios:
        raise FitError("no ball can be measured; press it deeper, and farther from the rim of the view")
    gain = float(np.median(ratios))
    response = made.response.copy()
    response[:, :2] *= gain
    response[:, 2:5] *= gain**2
    return replace(made, response=response)


def _solve(draft: HeightCalibration, fit: SensorFit, presses: Sequence[BallPress]) -> HeightCalibration:
    powers = place_powers(LR.size)
    matrix, vector = np.zeros((36, 36)), np.zeros((36, 3))
    parts: list[tuple[F64, F64]] = []
    for press in presses:
        part, truth = press.window, _surface(fit, press)
        reach = 1.5 * press.ball.contact_radius_mm(fit.ball_radius_mm) + 0.3
        near = _away(press)[part] < reach
        terms = surface_terms(_normals(truth)[:, *part], truth[part])[:, near]
        columns = (terms[:, None] * powers[:, *part][:, near]).reshape(36, -1)
        levels = press.change[:, *part][:, near].astype(np.float64)
        matrix += columns @ columns.T
        vector += columns @ levels.T
        parts.append((columns, levels))
    # A term is held to its own strength in the middle of the view.
    own = np.repeat(np.diag(matrix).reshape(6, 6)[:, 0], 6)
    response = np.linalg.solve(matrix + np.diag(_RIDGE * own), vector).T
    rest = [levels - response @ columns for columns, levels in parts]
    covariance = sum(one @ one.T for one in rest) / sum(one.shape[1] for one in rest)
    return replace(
        draft, response=np.asarray(response.reshape(3, 6, 6), np.float64), rest=np.asarray(covariance)
    )


def _surface(fit: SensorFit, press: BallPress) -> F64:
    """The gel's surface over a ball, mm."""
    return deformation(ball_height(press.ball, fit.ball_radius_mm, *grids(LR)), LR, fit.gel).astype(
        np.float64
    )


def _normals(surface: F64) -> F64:
    down, across = np.gradient(surface, LR.mm_per_px[0])
    return np.stack([-across, -down]) / np.asarray(np.sqrt(across**2 + down**2 + 1), np.float64)


def _away(press: BallPress) -> F64:
    x, y = grids(LR)
    return np.asarray(np.hypot(x - press.ball.x_mm, y - press.ball.y_mm), np.float64)


def _measure(made: HeightCalibration, fit: SensorFit, press: BallPress, free_rgb: U8) -> HeldBall | None:
    rgb = np.clip(np.rint(fit.free + press.change), 0, 255).astype(np.uint8).transpose(1, 2, 0)
    try:
        heights = measure_heights(np.ascontiguousarray(rgb), free_rgb, made)
    except HeightError:
        return None
    truth, away = _surface(fit, press), _away(press)
    contact = press.ball.contact_radius_mm(fit.ball_radius_mm)
    inside = away < contact
    seen = heights.heights_mm.astype(np.float64)
    radius, top = _measure_ball(heights, press.ball.x_mm, press.ball.y_mm, contact)
    return HeldBall(
        press.name,
        press.ball.x_mm,
        press.ball.y_mm,
        radius,
        press.ball.depth_mm,
        top,
        np.stack([truth, seen - truth])[:, inside][:, :: max(1, int(inside.sum()) // _PLACES)],
        float(np.percentile(np.abs(seen[heights.free]), 95)),
        float((seen * truth)[inside].sum() / (truth**2)[inside].sum()),
        float(band(seen, made.mm_per_px, CUT_OFFS_MM[0])[heights.free].std()),
    )


def _measure_ball(heights: HeightMap, x_mm: float, y_mm: float, contact_mm: float) -> tuple[float, float]:
    """Return radius and top of the sphere through the heights within 0.85 of the contact, by least squares, mm."""
    x, y = (grid.astype(np.float64) * heights.mm_per_px / LR.mm_per_px[0] for grid in grids(LR))
    near = np.hypot(x - x_mm, y - y_mm) < 0.85 * contact_mm
    points = np.column_stack([x[near], y[near], heights.heights_mm[near].astype(np.float64)])
    # |p|^2 = 2 p.c + (r^2 - |c|^2) is linear in centre and rest; two Gauss-Newton steps make it the distance.
    columns = np.column_stack([2 * points, np.ones(len(points))])
    centre = np.linalg.lstsq(columns, (points**2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(centre[3] + centre[:3] @ centre[:3], 0.0)))
    at = np.append(centre[:3], radius)
    for _ in range(10):
        apart = points - at[:3]
        length = np.linalg.norm(apart, axis=1)
        slope = np.column_stack([-apart / length[:, None], -np.ones(len(points))])
        at = at - np.linalg.lstsq(slope, length - at[3], rcond=None)[0]
    return float(at[3]), float(at[2] + at[3])


def _with_errors(made: HeightCalibration, held: Sequence[HeldBall]) -> HeightCalibration:
    """The calibration with errors that cover the places in balls that were held out."""
    floor = _quantile([press.outside_mm for press in held])
    true, error = np.hstack([press.inside_mm for press in held])
    share = _quantile((np.maximum(np.abs(error) - floor, 0) / np.maximum(true, floor)).tolist(), _COVERED)
    noise = float(np.median([press.noise_mm for press in held]))
    return replace(made, floor_u95_mm=floor, height_u95=share, noise_mm=noise)


def _quantile(values: Sequence[float], share: float = 0.95) -> float:
    """The value that this share of all does not exceed, as a sample can tell: the next one above."""
    return float(np.quantile(values, share, method="higher"))


def _scale(made: HeightCalibration, factor: float) -> HeightCalibration:
    """From millimetres of the maker's view to those of this sensor."""
    response = made.response.copy()
    response[:, 5] /= factor
    return replace(
        made,
        response=response,
        mm_per_px=made.mm_per_px * factor,
        floor_u95_mm=made.floor_u95_mm * factor,
        noise_mm=made.noise_mm * factor,
    )


def _in_mm(ball: HeldBall, factor: float) -> HeldBall:
    lengths = {name: factor * value for name, value in vars(ball).items() if name.endswith("_mm")}
    return replace(ball, **lengths)
