"""The checks of every detector: features that it can learn from, and the largest size of a bank."""

import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Features, Grid, Nominal
from edge.core.errors import FitError, NotScorable

__all__ = ["bank_bytes", "require_fittable", "require_scorable"]

# The area of the region for which a bank's size is stated, and how many times more a larger frame may have: 16 MB at
# 224x224 are 64 MB at 1280x720.
STATED_AREA, MOST_TIMES = 224 * 224, 4.0


def bank_bytes(bank_mb: float, grid: Grid) -> int:
    """Bytes that a bank may have as stored: `bank_mb` megabytes at 224x224, up to four times that for larger frames."""
    times = grid.frame[0] * grid.frame[1] / STATED_AREA
    return int(1e6 * bank_mb * min(max(times, 1.0), MOST_TIMES))


def require_fittable(detector: str, nominal: Nominal, grid: Grid, taps: tuple[str, ...]) -> None:
    """Refuse presses from which no bank can be learnt.

    Errors: FitError for a missing tap, no press, a shape that differs from the grid, a value that is not finite or out
    of range, or one press far stronger than the others.
    """
    _check(detector, "nominal presses", nominal.features, grid, taps)
    if nominal.no_contact is not None:
        _check(detector, "no-contact frames", nominal.no_contact, grid, taps)
    if nominal.touched is not None and nominal.touched.shape != grid.frame:
        raise FitError(
            f"{detector}: the touched mask is {nominal.touched.shape}, the inspected region is {grid.frame}; "
            "give both in pixels of the region"
        )


def require_scorable(detector: str, features: Features, taps: tuple[str, ...]) -> None:
    """Refuse a press that has no score. Errors: NotScorable for features that are not finite."""
    for tap in taps:
        if not np.isfinite(features[tap]).all():
            raise NotScorable(f"{detector}: '{tap}' of this press is not finite; it has no score")


# Float32 squares of smaller differences underflow and of larger ones overflow: a defect would have the score 0, or
# none. In tests every method is right from 1e-20 to 1e10.
FAINTEST, STRONGEST = 1e-15, 1e12
# One press this many times as strong as the median sets the directions, prototypes and int8 steps of the others.
# Measured: 100 times does no harm, 1000 times costs 5 % of the peak, a million times everything.
MOST_APART = 100.0


def _check(detector: str, what: str, features: Features, grid: Grid, taps: tuple[str, ...]) -> None:
    counts = set()
    for tap in taps:
        if tap not in features or tap not in grid.taps:
            raise FitError(
                f"{detector} needs the tap '{tap}', found {sorted(features)}; use a trunk that gives it"
            )
        shape = features[tap].shape
        if shape[1:] != tuple(grid.taps[tap]):
            raise FitError(
                f"{detector}: '{tap}' of the {what} is {shape[1:]}, the grid says {grid.taps[tap]}"
            )
        if not shape[0]:
            raise FitError(f"{detector}: there are no {what}; press at least one good part")
        counts.add(shape[0])
        _check_strength(f"{detector}: '{tap}'", what, features[tap])
    if len(counts) > 1:
        raise FitError(f"{detector}: the taps hold different numbers of {what}: {sorted(counts)}")


def _check_strength(tap: str, what: str, maps: NDArray[np.floating]) -> None:
    """Refuse values (n, c, h, w) that are not finite, out of range, or of one press far stronger than the others'."""
    strength = np.array([max(float(press.max()), -float(press.min())) for press in maps])
    if not np.isfinite(strength).all():
        bad = np.flatnonzero(~np.isfinite(strength))
        raise FitError(f"{tap} is not finite in {what} {bad[:5].tolist()}; leave those out")
    top = float(strength.max())
    if top and not FAINTEST <= top <= STRONGEST:
        raise FitError(
            f"{tap} of the {what} reaches {top:.3g}; values between {FAINTEST:g} and {STRONGEST:g} have distances in "
            "float32: use a trunk whose outputs are of order one"
        )
    usual = float(np.sort(strength)[(len(strength) - 1) // 2])
    apart = np.flatnonzero(strength > MOST_APART * usual)
    if len(apart):
        raise FitError(
            f"{tap} of {what} {apart[:5].tolist()} is more than {MOST_APART:g} times as strong as usual "
            f"({top:.3g}, usually {usual:.3g}); leave those out"
        )
