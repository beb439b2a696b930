"""The presses that a fit can use, with a ball in view, on this gel, under this light; the others with the reason."""

from collections.abc import Iterator, Sequence

import numpy as np

from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.sensor_fit.ball import Circle, find_circle
from calibration.sensor_fit.fit import BallPress
from calibration.sensor_fit.gel_colours import has_markers, marker_dots
from calibration.sensor_fit.prediction import CONSTANT_COLUMNS, predict, window_around
from calibration.simulator.field_of_view import LR
from calibration.simulator.gel import GEL
from edge.core.arrays import F32, Mask
from edge.core.errors import FitError

__all__ = ["ball_presses", "check_ball", "untouched_gel"]

LEAST_PRESSES = 3
# Outside contact a press differs from its own free gel by the noise alone, about 2 levels; two real sensors differ by
# 11 or more, and exposure that wandered by a tenth gives as much.
_OTHER_GEL_LEVELS = 7.0
# A contact that leaves less of the view is a change everywhere.
_LEAST_AWAY = 0.2
# Of a contact's pixels, which channel at its end says nothing of the slope.
_SATURATED_LEVEL, _MOST_SATURATED = 254, 0.1
_SMALLEST_MM = 0.4
# Of the change of a press: real balls leave 0.23 to 0.45, simulated parts 0.92 to 0.98, a flat square 0.57.
_NO_BALL = 0.5


def untouched_gel(presses: NominalPresses) -> tuple[F32, Mask]:
    """Return the free gel, planes float32 (3, 240, 320), and its marker dots, bool (240, 320).

    Errors: FitError without a picture of the free gel.
    """
    if presses.no_contact is None or presses.estimated:
        todo = "give one with --no-contact, or a recording that begins before contact"
        raise FitError("; ".join(["there is no picture of the free gel", todo, *presses.faults]))
    mean = presses.no_contact.mean(axis=0, dtype=np.float64).transpose(2, 0, 1)
    planes = np.ascontiguousarray(mean, dtype=np.float32)
    return planes, marker_dots(planes) if has_markers(planes) else np.zeros(LR.shape, np.bool_)


def check_ball(ball_radius_mm: float) -> None:
    """Check the ball. Errors: FitError for a ball that is larger than the view."""
    if 2 * ball_radius_mm > LR.extent_mm[1]:
        raise FitError(
            f"a ball of radius {ball_radius_mm:g} mm is larger than the view, which is {LR.extent_mm[1]:.1f} mm high; "
            "use a ball of 2 to 6 mm radius, and give its radius, not its diameter"
        )


def ball_presses(
    presses: NominalPresses, free: F32, dots: Mask, ball_radius_mm: float
) -> tuple[list[BallPress], dict[str, str]]:
    """Return every press with its ball found, and for each of the others why not, by its name.

    free, dots: as from `untouched_gel`. ball_radius_mm: in millimetres of a view that is 20.3 mm wide.

    Errors: FitError where the free gel is of another sensor, the ball is smaller than its contacts, or fewer than
    three presses can be used.
    """
    left_out: dict[str, str] = {}
    usable: list[BallPress] = []
    circles: list[Circle] = []
    strangers = 0
    for name, frame in zip(presses.names, presses.frames, strict=True):
        planes = frame.transpose(2, 0, 1).astype(np.float32)
        ignored = dots | marker_dots(planes) if dots.any() else dots
        change = planes - free
        circle = find_circle(change, ignored)
        away = _outside_levels(change, circle, ignored)
        strangers += away > _OTHER_GEL_LEVELS
        reason = next(_reasons(planes, circle, away), "")
        if circle is not None and not reason:
            circles.append(circle)
            ball = circle.ball(ball_radius_mm)
            window = window_around(ball, ball.contact_radius_mm(ball_radius_mm))
            press = BallPress(name, change, ignored, ball, window)
            reason = _why_no_ball(press, free, ball_radius_mm)
        if reason:
            left_out[name] = reason
        else:
            usable.append(press)
    _require_own_gel(strangers, len(presses))
    _require_radius(circles, ball_radius_mm)
    _require_enough(len(usable), left_out)
    return usable, left_out


def _reasons(planes: F32, circle: Circle | None, away: float) -> Iterator[str]:
    """Say why a press cannot be used, a clause each."""
    if away > _OTHER_GEL_LEVELS:
        yield f"outside contact it differs from the free gel by {away:.0f} grey levels, at most {_OTHER_GEL_LEVELS:.0f}"
    if circle is None or circle.touching_mm < _SMALLEST_MM:
        yield "no contact was found in it"
        return
    if not circle.is_inside(LR.size):
        yield "its contact reaches beyond the view"
        return
    at_its_end = np.asarray((planes >= _SATURATED_LEVEL).any(axis=0), np.bool_)
    saturated = float(at_its_end[_disc(circle, 0.85)].mean())
    if saturated > _MOST_SATURATED:
        yield f"{saturated:.0%} of its contact is saturated; lower the exposure"


def _why_no_ball(press: BallPress, free: F32, ball_radius_mm: float) -> str:
    """Say why a press is no ball's, empty for a ball: under any light a ball's change follows its own slopes."""
    seen = predict(press.ball, ball_radius_mm, GEL, free, press.window)
    compared = seen.changed & ~press.ignored[press.window]
    change = press.change[:, *press.window][:, compared].T
    columns = seen.columns[list(CONSTANT_COLUMNS)][:, compared].T
    rest = change - columns @ np.linalg.lstsq(columns, change, rcond=None)[0]
    share = float(np.linalg.norm(rest) / np.linalg.norm(change))
    return f"{share:.0%} of its change does not follow the slopes of a ball" if share > _NO_BALL else ""


def _disc(circle: Circle, share: float) -> Mask:
    rows, columns = np.mgrid[0 : LR.size[1], 0 : LR.size[0]]
    return np.asarray(np.hypot(columns - circle.x, rows - circle.y) < share * circle.radius)


def _outside_levels(change: F32, circle: Circle | None, ignored: Mask) -> float:
    """The median over the pixels away from the contact of the largest channel's change."""
    away = ~ignored if circle is None else ~ignored & ~_disc(circle, 1.6)
    if away.mean() < _LEAST_AWAY:
        away = ~ignored
    return float(np.median(np.abs(change).max(axis=0)[away]))


def _require_own_gel(strangers: int, presses: int) -> None:
    if 2 * strangers > presses:
        raise FitError(
            f"the free gel is not that of these presses: {strangers} of {presses} differ from it by more than "
            f"{_OTHER_GEL_LEVELS:.0f} grey levels outside contact; give a picture of the same sensor, gel and exposure"
        )


def _require_enough(usable: int, left_out: dict[str, str]) -> None:
    if usable < LEAST_PRESSES:
        reasons = "".join(f"\n  {name}: {reason}" for name, reason in left_out.items())
        raise FitError(
            f"{usable} presses of the ball can be used, at least {LEAST_PRESSES} are needed; press it at more places, "
            f"completely in view{reasons}"
        )


def _require_radius(circles: Sequence[Circle], ball_radius_mm: float) -> None:
    touching = float(np.median([circle.touching_mm for circle in circles])) if circles else 0.0
    if touching > 0.95 * ball_radius_mm:
        raise FitError(
            f"a ball of radius {ball_radius_mm:.2f} mm cannot leave contacts of {touching:.2f} mm radius; check the "
            "radius and the scale (--mm-per-px)"
        )
