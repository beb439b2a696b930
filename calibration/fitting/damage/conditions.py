"""Nominal presses as a station sees them over its years (light, exposure, a lighter press), and of a smoother object.

From these `fit` learns what a smoother object lacks.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.rendering import EditedPress, edit_touching
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.arrays import F32, U8
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["ChangedPresses", "change_presses", "dim", "relight", "weaken"]

SMOOTHED_MM = (0.2, 0.4)
"""Standard deviations over which the surface of a smoother object is averaged: a texture of half a millimetre is gone
with the first, and features of a millimetre with the second."""

DIMMED, FAINTER = 0.85, 0.7
"""Exposure wanders by a fifth on real sensors. A press of 0.7 of the depth changes the features of simulated parts less
than 0.7 of the contrast does."""

PRESSES, _FEWEST, _PRESSES_PX = 12, 6, 12 * 320 * 240

# Another light: gains of each colour and their slope from edge to edge of the picture. A choice; automatic exposure
# moves the level of a GelSight Mini by a fifth within a session (edge/core/imaging/known_profiles.py).
_GAIN, _SLOPE = 0.15, 0.08


@dataclass(frozen=True, eq=False)
class ChangedPresses:
    """Some nominal presses, each changed in the same ways."""

    press: NDArray[np.int64]
    """Which nominal press each was, (m,)."""
    same: tuple[U8, ...]
    """Under another condition, uint8 (m, h, w, 3) of every kind."""
    smoother: tuple[U8, ...]
    """Of a smoother object, uint8 (m, h, w, 3) of every kind."""


def change_presses(
    presses: NominalPresses, profile: SensorProfile, region: Region, rng: np.random.Generator
) -> ChangedPresses | None:
    """Change at most PRESSES presses; None without a picture of the free gel, or a contact to make smoother."""
    most = max(_FEWEST, min(PRESSES, _PRESSES_PX // (region.width * region.height)))
    shown = edit_touching(presses, profile, region, rng, most)
    if not shown:
        return None

    def change_each(change: Callable[[EditedPress], U8]) -> U8:
        return np.stack([change(one) for one in shown.values()])

    return ChangedPresses(
        np.array(list(shown)),
        (
            change_each(lambda one: relight(one.show(one.rgb), rng)),
            change_each(lambda one: dim(one.show(one.rgb), DIMMED)),
            change_each(lambda one: weaken(one.show(one.rgb), one.station.free, FAINTER)),
        ),
        tuple(change_each(lambda one, mm=mm: one.smooth(mm)) for mm in SMOOTHED_MM),  # type: ignore[misc]
    )


def relight(rgb: U8, rng: np.random.Generator) -> U8:
    """The press under another light: each colour brighter or darker, by a share that changes over the picture."""
    height, width = rgb.shape[:2]
    v, u = np.linspace(-1, 1, height)[:, None, None], np.linspace(-1, 1, width)[None, :, None]
    gain, across, down = (rng.uniform(-most, most, 3) for most in (_GAIN, _SLOPE, _SLOPE))
    return _levels(rgb * (1 + gain + across * u + down * v))


def dim(rgb: U8, share: float) -> U8:
    """The press at this share of the exposure."""
    return _levels(rgb * np.float32(share))


def weaken(rgb: U8, free: F32, share: float) -> U8:
    """The press with this share of its difference to the free gel, float32 (h, w, 3)."""
    return _levels(free + np.float32(share) * (rgb - free))


def _levels(found: NDArray[np.floating]) -> U8:
    return np.clip(np.round(found), 0, 255).astype(np.uint8)
