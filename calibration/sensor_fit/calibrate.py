"""From presses of a ball to a sensor's file, with the errors of held-out presses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.sensor_fit.fit import BallPress, fit_gel, fit_response
from calibration.sensor_fit.free_gel import fit_free_gel, fit_noise
from calibration.sensor_fit.presses import (
    Untouched,
    ball_presses,
    check_ball,
    untouched_gel,
)
from calibration.sensor_fit.result import Judged, gain, judge, rms_of, with_response
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.sensor_appearance import SensorAppearance
from calibration.simulator.sensor_file import SensorFile
from edge.core.detector import Progress

__all__ = ["MOST_PRESSES", "Calibrated", "calibrate_sensor", "divide"]

Press = TypeVar("Press")

MOST_PRESSES = 20
"""More presses are judged, not fitted."""
# The response of three real units to a slope differs by a factor of up to 1.7 in one colour, and less over all three.
_GAINS = (0.6, 1.75)


@dataclass(frozen=True)
class Calibrated:
    """The sensor's file, every press that was judged, the presses left out with the reason, and what is doubtful."""

    sensor: SensorFile
    judged: tuple[Judged, ...]
    left_out: dict[str, str]
    warnings: tuple[str, ...]


def calibrate_sensor(
    presses: NominalPresses,
    name: str,
    ball_radius_mm: float,
    mm_per_px: float = LR.mm_per_px[0],
    progress: Progress | None = None,
) -> Calibrated:
    """Fit a sensor to presses of one ball, frames uint8 (n, 240, 320, 3) with a free gel.

    mm_per_px: of these frames. A simulated frame always shows 20.3 mm, so a sensor of another scale is fitted in
    millimetres of that view, and its colours are in the same places of the picture. Errors: FitError as
    `ball_presses` and `untouched_gel`.
    """
    scale = LR.mm_per_px[0] / mm_per_px
    radius = ball_radius_mm * scale
    check_ball(radius)
    gel = untouched_gel(presses)
    found = ball_presses(presses, gel, radius)
    fitted, others = divide(found.usable)
    fit = fit_gel(fit_response(fitted, gel.planes, radius), fitted, progress)
    base = _base(name, gel, [*fitted, *others], radius)
    judged = judge(fit, base, fitted, others)
    sensor = _file(with_response(base, fit), judged, gel, len(fitted), ball_radius_mm, mm_per_px)
    return Calibrated(sensor, tuple(judged), found.left_out, tuple(_warnings(with_response(base, fit), gel)))


def divide(presses: Sequence[Press]) -> tuple[list[Press], list[Press]]:
    """Divide the presses into at most 20, spread over all, and the others."""
    most = min(MOST_PRESSES, len(presses))
    chosen = set(np.linspace(0, len(presses) - 1, most).round().astype(int).tolist())
    fitted = [press for number, press in enumerate(presses) if number in chosen]
    return fitted, [press for number, press in enumerate(presses) if number not in chosen]


def _base(name: str, gel: Untouched, presses: Sequence[BallPress], radius: float) -> SensorAppearance:
    """The appearance before the response: the free gel's colours and the noise."""
    x, y = grids(LR)
    untouched = [
        (np.hypot(x - press.ball.x_mm, y - press.ball.y_mm) > 2 * press.ball.contact_radius_mm(radius))
        & ~press.ignored
        for press in presses
    ]
    level = gel.planes.mean(axis=(1, 2)).tolist()
    return SensorAppearance(
        name,
        fit_free_gel(gel.planes, gel.dots),
        noise_sd=fit_noise([press.change for press in presses], untouched, level),
    )


def _file(
    appearance: SensorAppearance,
    judged: Sequence[Judged],
    gel: Untouched,
    fitted: int,
    ball_radius_mm: float,
    mm_per_px: float,
) -> SensorFile:
    inside, outside = rms_of(judged)
    assert appearance.height_response is not None
    lengths = appearance.gel
    return SensorFile.model_validate(
        {
            "version": 1,
            "name": appearance.name,
            "free_gel": _rows(appearance.free_gel, 4),
            "slope_response": _rows(appearance.slope_response, 2),
            "height_response": _rows(appearance.height_response, 2),
            "noise_sd": tuple(round(sd, 2) for sd in appearance.noise_sd),
            "gel": {
                "short_mm": round(lengths.short_mm, 3),
                "long_mm": round(lengths.long_mm, 3),
                "long_share": round(lengths.long_share, 3),
            },
            "fitted": {
                "presses": fitted,
                "ball_radius_mm": ball_radius_mm,
                "mm_per_px": mm_per_px,
                "inside_levels": round(inside, 2),
                "outside_levels": round(outside, 2),
                "has_markers": gel.has_markers,
            },
        }
    )


def _rows(table: NDArray[np.float64], digits: int) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(round(value, digits) for value in row) for row in table.tolist())


def _warnings(appearance: SensorAppearance, gel: Untouched) -> list[str]:
    found = []
    strength = gain(appearance)
    if not _GAINS[0] <= strength <= _GAINS[1]:
        found.append(
            f"the colours answer a slope {strength:.1f} times as strongly as those of known sensors, {_GAINS[0]:g} to "
            f"{_GAINS[1]:g} times is expected: check the ball's radius (not its diameter) and --mm-per-px"
        )
    if gel.has_markers:
        found.append(
            "the gel has markers: they are left out of the fit and of the errors; name the effect 'markers' in a scene"
        )
    return found
