"""How well a fitted sensor predicts presses that it was not fitted to, judged through the renderer itself."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.sensor_fit.ball import ball_height
from calibration.sensor_fit.fit import BallPress, SensorFit, fit_poses, fit_without_each
from calibration.simulator.camera import quantise
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.preview import title_picture
from calibration.simulator.renderer import Renderer
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance
from edge.core.arrays import F32, F64, U8

__all__ = ["Judged", "calibration_sheet", "gain", "judge", "rms_of", "with_response"]

# What a scene computes of a still press on a clean gel; noise and grain are left out, they have no place to compare.
_EFFECTS = ("deformation", "illumination", "shadows", "specular", "vignette", "lens_blur")
_PLACING_STEPS = 5


@dataclass(frozen=True, eq=False)
class Judged:
    """One press, held out: errors in grey levels rms inside and outside contact; pictures float32 (3, 240, 320)."""

    name: str
    inside: float
    outside: float
    signal: float
    pixels: int
    real: F32
    simulated: F32


def with_response(base: SensorAppearance, fit: SensorFit) -> SensorAppearance:
    """The appearance with the fitted response and gel."""
    return replace(
        base, slope_response=fit.response[:, :15], height_response=fit.response[:, 15:], gel=fit.gel
    )


def judge(
    fit: SensorFit, base: SensorAppearance, fitted: Sequence[BallPress], others: Sequence[BallPress] = ()
) -> list[Judged]:
    """Each fitted press by a fit without its fold, each other press by the complete fit."""
    judged = [
        _judge(with_response(base, one), fit, press)
        for press, one in zip(fitted, fit_without_each(fit, fitted), strict=True)
    ]
    complete = with_response(base, fit)
    for press in others:
        fit_poses(fit, [press], _PLACING_STEPS)
        judged.append(_judge(complete, fit, press))
    return judged


def rms_of(judged: Sequence[Judged]) -> tuple[float, float]:
    """Inside and outside over all presses, each press with its number of pixels inside."""
    weights = np.array([press.pixels for press in judged], dtype=np.float64)
    inside = np.array([press.inside for press in judged])
    outside = np.array([press.outside for press in judged])
    return float(np.sqrt((weights * inside**2).sum() / weights.sum())), float(np.sqrt((outside**2).mean()))


def _judge(appearance: SensorAppearance, fit: SensorFit, press: BallPress) -> Judged:
    x, y = grids(LR)
    height = ball_height(press.ball, fit.ball_radius_mm, x, y)
    renderer = Renderer(LR, _EFFECTS, appearance)
    simulated = renderer.light(renderer.imprint(height, 0.0))
    real = fit.free + press.change
    error = np.clip(simulated, 0, 255) - real
    inside = (height > 0) & ~press.ignored
    reach = 1.5 * press.ball.contact_radius_mm(fit.ball_radius_mm) + 0.3
    outside = (np.hypot(x - press.ball.x_mm, y - press.ball.y_mm) > reach) & ~press.ignored
    return Judged(
        press.name,
        _rms(error[:, inside]),
        _rms(error[:, outside]),
        _rms(press.change[:, inside]),
        int(inside.sum()),
        real,
        simulated,
    )


def _rms(values: F32) -> float:
    return float(np.sqrt((values.astype(np.float64) ** 2).mean())) if values.size else 0.0


def gain(appearance: SensorAppearance) -> float:
    """Measure how strongly colours answer a slope, as a share of the shipped sensors' response."""

    def strength(response: F64) -> float:
        return float(np.linalg.norm(response[:, [0, 6]]))

    return strength(appearance.slope_response) / strength(SENSORS["unit_b"].slope_response)


_MAGNIFIED, _SHOWN = 4, 8


def calibration_sheet(judged: Sequence[Judged]) -> U8:
    """Draw at most eight presses, the best to the worst: real, simulated, difference x 4 about mid grey; RGB."""
    ranked = sorted(judged, key=lambda one: one.inside)
    shown = np.linspace(0, len(ranked) - 1, min(_SHOWN, len(ranked))).round().astype(int)
    rows = []
    for press in (ranked[k] for k in shown):
        titled = {
            f"{press.name}: real": press.real,
            f"simulated, {press.inside:.1f} levels rms inside contact": press.simulated,
            f"difference x{_MAGNIFIED}": 128 + _MAGNIFIED * (press.simulated - press.real),
        }
        rows.append(np.hstack([title_picture(quantise(planes), title) for title, planes in titled.items()]))
    return np.vstack(rows)
