"""The fit: response, gel, and the pose of every press, in turns, each by least squares.

The response (colours by slope and by height) is linear, so it is solved exactly. A press has three unknowns (where, how
deep), which Gauss-Newton steps follow. The gel's three numbers are tried one after the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.sensor_fit.ball import Ball
from calibration.sensor_fit.prediction import COLUMNS, CONSTANT_COLUMNS, Prediction, Window, predict
from calibration.simulator.gel import GEL, Gel
from edge.core.arrays import F32, F64, Mask
from edge.core.detector import Progress

__all__ = ["BallPress", "SensorFit", "fit_gel", "fit_poses", "fit_response", "fit_without_each"]

# Turns of poses and response: the error falls by less than 0.05 levels in further ones (measured on 89 presses).
_TURNS, _GEL_TURNS, _HELD_STEPS = 3, 1, 5
_FOLDS = 5
# Steps of the numerical derivative, and the largest step of a turn, in mm.
_DELTA_MM, _MOST_MM = (0.02, 0.02, 0.01), (0.3, 0.3, 0.1)
# Shares of the mean diagonal that are added to the normal equations: little to what is constant over the view, more to
# its change from place to place, which a few presses do not show.
_RIDGE, _PLACE_RIDGE = 1e-5, 3e-3
_IS_BY_PLACE = np.array([k not in CONSTANT_COLUMNS for k in range(COLUMNS)])
# The gel is chosen on this many presses.
_GEL_PRESSES, _LEAST_FOR_GEL = 8, 5


@dataclass(eq=False)
class BallPress:
    """One press: its name, its change against the free gel (3, h, w), what is not compared, and where the ball is."""

    name: str
    change: F32
    ignored: Mask
    start: Ball
    """Where the ball was found."""
    window: Window
    """The window around the ball."""
    ball: Ball = field(init=False)

    def __post_init__(self) -> None:
        self.ball = self.start


@dataclass(frozen=True, eq=False)
class SensorFit:
    """What is common to all presses."""

    ball_radius_mm: float
    free: F32
    """The free gel, float32 (3, 240, 320)."""
    gel: Gel
    response: F64
    """float64 (3, 21)."""

    def predicted(self, press: BallPress, ball: Ball | None = None) -> Prediction:
        return predict(ball or press.ball, self.ball_radius_mm, self.gel, self.free, press.window)

    def rest(self, press: BallPress, seen: Prediction) -> F32:
        """Real less predicted, float32 (3, rows, cols), 0 where nothing is compared."""
        error = press.change[:, *press.window] - seen.change(self.response)
        error[:, ~seen.changed | press.ignored[press.window]] = 0
        return np.asarray(error, np.float32)


def fit_response(presses: Sequence[BallPress], free: F32, ball_radius_mm: float) -> SensorFit:
    """Response and poses, with the gel of the shipped sensors."""
    return _turns(SensorFit(ball_radius_mm, free, GEL, np.zeros((3, COLUMNS))), presses, _TURNS)


def fit_gel(fit: SensorFit, presses: Sequence[BallPress], progress: Progress | None = None) -> SensorFit:
    """The gel too, then response and poses again; with fewer than five presses the gel is kept. progress: 0 to 1."""
    say = progress or (lambda _: None)
    if len(presses) >= _LEAST_FOR_GEL:
        fit = _with_gel(fit, presses[:: -(-len(presses) // _GEL_PRESSES)])
    say(0.7)
    fit = _turns(fit, presses, 2)
    say(1.0)
    return fit


def _turns(fit: SensorFit, presses: Sequence[BallPress], count: int) -> SensorFit:
    """Response and poses in turns; it ends with the response."""
    for _ in range(count):
        fit = replace(fit, response=_response([_equations(fit, press) for press in presses]))
        fit_poses(fit, presses, 1)
    return replace(fit, response=_response([_equations(fit, press) for press in presses]))


def _equations(fit: SensorFit, press: BallPress) -> F64:
    """Return the normal equations of one press, (3, 21, 22): a matrix and, in the last column, a vector."""
    seen = fit.predicted(press)
    compared = seen.changed & ~press.ignored[press.window]
    columns = seen.columns[:, compared].astype(np.float64)
    target = (press.change[:, *press.window] - seen.offset)[:, compared].astype(np.float64)
    equations = []
    for kept, level in zip(seen.kept[:, compared].astype(np.float64), target, strict=True):
        weighted = columns * kept
        equations.append(np.column_stack([weighted @ weighted.T, weighted @ level]))
    return np.array(equations)


def _response(equations: Sequence[F64]) -> F64:
    """Solve all presses together, float64 (3, 21)."""
    both = np.sum(equations, axis=0)
    matrix, vector = both[..., :-1], both[..., -1:]
    for square in matrix:
        for part in (slice(0, 15), slice(15, COLUMNS)):
            shares = np.where(_IS_BY_PLACE[part], _PLACE_RIDGE, _RIDGE)
            square[part, part] += np.diag(shares * np.trace(square[part, part]) / len(shares))
    return np.asarray(np.linalg.solve(matrix, vector)[:, :, 0])


def fit_poses(fit: SensorFit, presses: Sequence[BallPress], steps: int) -> None:
    """Move each press's ball to where the prediction fits best, by Gauss-Newton steps."""
    for press in presses:
        for _ in range(steps):
            press.ball = _step(fit, press)


def _step(fit: SensorFit, press: BallPress) -> Ball:
    """Return the ball after one step."""
    at = fit.predicted(press)
    rest, before = fit.rest(press, at), at.change(fit.response)
    compared = at.changed & ~press.ignored[press.window]
    slopes = [
        (fit.predicted(press, _move(press.ball, step)).change(fit.response) - before)[:, compared].ravel()
        / np.abs(step).sum()
        for step in np.diag(_DELTA_MM)
    ]
    jacobian = np.array(slopes, dtype=np.float64)
    square = jacobian @ jacobian.T
    square += np.diag(1e-3 * np.diag(square) + 1e-9)
    step = np.linalg.solve(square, jacobian @ rest[:, compared].ravel())
    moved = _move(press.ball, np.clip(step, -np.array(_MOST_MM), _MOST_MM))
    deepest = min(0.95 * fit.ball_radius_mm, 2.0)
    return replace(moved, depth_mm=min(max(moved.depth_mm, 0.02), deepest))


def _move(ball: Ball, by_mm: F64) -> Ball:
    across, down, deeper = by_mm.tolist()
    return Ball(ball.x_mm + across, ball.y_mm + down, ball.depth_mm + deeper)


def _with_gel(fit: SensorFit, presses: Sequence[BallPress]) -> SensorFit:
    """The fit with the gel that leaves the least error, changed one number at a time while that helps."""
    best, least = fit, error_of(fit, presses)
    for change in _GEL_CHANGES:
        while (gel := _scale_gel(best.gel, *change)) is not None:
            poses = [press.ball for press in presses]
            candidate = _turns(replace(best, gel=gel), presses, _GEL_TURNS)
            error = error_of(candidate, presses)
            if error > least - 0.01:
                for press, ball in zip(presses, poses, strict=True):
                    press.ball = ball
                break
            best, least = candidate, error
    return best


# Factors of (short_mm, long_mm), and what is added to long_share. The relaxation lengths of real gels lie within these
# bounds: beyond 1.5 mm the two membranes are one.
_GEL_CHANGES = (
    *((1.4, 1.0, 0.0), (1 / 1.4, 1.0, 0.0), (1.0, 1.0, 0.15), (1.0, 1.0, -0.15)),
    *((1.0, 1.3, 0.0), (1.0, 1 / 1.3, 0.0), (1.2, 1.0, 0.0), (1 / 1.2, 1.0, 0.0)),
)
_SHORTEST_MM, _LONGEST_MM = 0.1, 3.0


def _scale_gel(gel: Gel, short: float, long: float, share: float) -> Gel | None:
    made = (gel.short_mm * short, gel.long_mm * long, gel.long_share + share)
    is_possible = _SHORTEST_MM <= made[0] <= made[1] <= _LONGEST_MM and 0 <= made[2] <= 1
    return Gel(*made) if is_possible else None


def error_of(fit: SensorFit, presses: Sequence[BallPress]) -> float:
    """Rms of what the prediction leaves, in grey levels, where the gel is lifted."""
    squares, counted = 0.0, 0
    for press in presses:
        seen = fit.predicted(press)
        squares += float((fit.rest(press, seen).astype(np.float64) ** 2).sum())
        counted += 3 * int((seen.changed & ~press.ignored[press.window]).sum())
    return float(np.sqrt(squares / max(counted, 1)))


def fit_without_each(fit: SensorFit, presses: Sequence[BallPress]) -> list[SensorFit]:
    """Fit for each press the same without it and its fold; its ball is placed again, from the circle that was found.

    Five folds. The gel is the one of the complete fit.
    """
    equations = [_equations(fit, press) for press in presses]
    folds = min(_FOLDS, len(presses))
    fits: list[SensorFit] = [fit] * len(presses)
    for fold in range(folds):
        others = [equation for number, equation in enumerate(equations) if number % folds != fold]
        without = replace(fit, response=_response(others))
        for number in range(fold, len(presses), folds):
            presses[number].ball = presses[number].start
            fit_poses(without, [presses[number]], _HELD_STEPS)
            fits[number] = without
    return fits
