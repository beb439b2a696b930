"""Nominal presses under other conditions, and of a smoother object: from these `fit` learns what is missing."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.conditions import dimmed, fainter, relit
from calibration.fitting.damage.imprint import Station
from calibration.fitting.damage.rendering import EditedPress
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["SMOOTHED_MM", "ChangedPresses", "changed_presses"]

U8 = NDArray[np.uint8]

SMOOTHED_MM = (0.2, 0.4)
"""Standard deviations over which the surface of a smoother object is averaged: a texture of half a millimetre is gone
with the first, and features of a millimetre with the second."""

DIMMED, FAINTER = 0.85, 0.7
"""Exposure wanders by a fifth on real sensors. A press of 0.7 of the depth changes the features of simulated parts less
than 0.7 of the contrast does."""

PRESSES, _FEWEST, _PRESSES_PX = 12, 6, 12 * 320 * 240


@dataclass(frozen=True, eq=False)
class ChangedPresses:
    """press: which nominal press each was, int64 (m,). same: under another condition, smoother: of a smoother object;
    uint8 (m, h, w, 3) of every kind."""

    press: NDArray[np.int64]
    same: tuple[U8, ...]
    smoother: tuple[U8, ...]


def changed_presses(
    presses: NominalPresses, profile: SensorProfile, region: Region, rng: np.random.Generator
) -> ChangedPresses | None:
    """Of at most PRESSES presses; None without a picture of the free gel, or a contact to make smoother."""
    if presses.no_contact is None:
        return None
    free = np.asarray(presses.no_contact.mean(axis=0, dtype=np.float64), np.float32)
    station = Station(profile, region, free)
    order = rng.permutation(len(presses)).tolist()
    shown = {k: one for k in order[: _count(region)] if (one := _pressed(station, presses.frames[k]))}
    if not shown:
        return None

    def of_each(change: Callable[[EditedPress], U8]) -> U8:
        return np.stack([change(one) for one in shown.values()])

    return ChangedPresses(
        np.array(list(shown)),
        (
            of_each(lambda one: relit(one.rgb, rng)),
            of_each(lambda one: dimmed(one.rgb, DIMMED)),
            of_each(lambda one: fainter(one.rgb, free, FAINTER)),
        ),
        tuple(of_each(lambda one, mm=mm: one.smoothed(mm)) for mm in SMOOTHED_MM),  # type: ignore[misc]
    )


def _pressed(station: Station, rgb: U8) -> EditedPress | None:
    one = EditedPress(station, rgb)
    return one if one.contact.any() else None


def _count(region: Region) -> int:
    return max(_FEWEST, min(PRESSES, _PRESSES_PX // (region.width * region.height)))
