"""From presses of a ball to a sensor's file, with the errors of held-out presses."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.sensor_fit.fit import BallPress, fit_gel, fit_response
from calibration.sensor_fit.gel_colours import fit_free_gel, fit_noise
from calibration.sensor_fit.presses import ball_presses, check_ball, untouched_gel
from calibration.sensor_fit.result import Judged, gain, judge, rms_of, with_response
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.sensor_appearance import SensorAppearance
from calibration.simulator.sensor_file import Fitted, SensorFile
from edge.core.arrays import F32
from edge.core.detector import Progress

__all__ = ["Calibrated", "calibrate_sensor", "divide"]

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
    radius = ball_radius_mm * LR.mm_per_px[0] / mm_per_px
    check_ball(radius)
    free, dots = untouched_gel(presses)
    usable, left_out = ball_presses(presses, free, dots, radius)
    fitted, others = divide(usable)
    fit = fit_gel(fit_response(fitted, free, radius), fitted, progress)
    noise = _noise(usable, free, radius)
    base = SensorAppearance(name, fit_free_gel(free, dots), noise_sd=noise)
    judged = judge(fit, base, fitted, others)
    appearance, has_markers = with_response(base, fit), bool(dots.any())
    inside, outside = rms_of(judged)
    facts = Fitted(
        presses=len(fitted),
        ball_radius_mm=ball_radius_mm,
        mm_per_px=mm_per_px,
        inside_levels=round(inside, 2),
        outside_levels=round(outside, 2),
        has_markers=has_markers,
    )
    sensor = SensorFile.of(appearance, facts)
    return Calibrated(sensor, tuple(judged), left_out, tuple(_warn(appearance, has_markers)))


def divide(presses: Sequence[Press]) -> tuple[list[Press], list[Press]]:
    """Divide the presses into at most 20, spread over all, and the others."""
    most = min(MOST_PRESSES, len(presses))
    chosen = set(np.linspace(0, len(presses) - 1, most).round().astype(int).tolist())
    fitted = [press for number, press in enumerate(presses) if number in chosen]
    return fitted, [press for number, press in enumerate(presses) if number not in chosen]


def _noise(presses: Sequence[BallPress], free: F32, radius: float) -> tuple[float, float, float]:
    """The noise of one frame, where the gel is untouched."""
    x, y = grids(LR)
    untouched = [
        (np.hypot(x - press.ball.x_mm, y - press.ball.y_mm) > 2 * press.ball.contact_radius_mm(radius))
        & ~press.ignored
        for press in presses
    ]
    return fit_noise([press.change for press in presses], untouched, free.mean(axis=(1, 2)).tolist())


def _warn(appearance: SensorAppearance, has_markers: bool) -> Iterator[str]:
    """Say what is doubtful about a fit."""
    strength = gain(appearance)
    if not _GAINS[0] <= strength <= _GAINS[1]:
        yield (
            f"the colours answer a slope {strength:.1f} times as strongly as those of known sensors, {_GAINS[0]:g} to "
            f"{_GAINS[1]:g} times is expected: check the ball's radius (not its diameter) and --mm-per-px"
        )
    if has_markers:
        yield (
            "the gel has markers: they are left out of the fit and of the errors; name the effect 'markers' in a scene"
        )
