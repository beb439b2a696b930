"""Nominal presses with small damage rendered into them: by what they show of it `fit` chooses a limit."""

from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.damage.damage import KINDS, Damage, Spot
from calibration.fitting.damage.footprint import surroundings
from calibration.fitting.damage.imprint import Station
from calibration.fitting.damage.rendering import EditedPress
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.simulator.field_of_view import grids
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["EditedPresses", "edited_presses"]

SIZE_SHARES = (1 / 16, 1 / 8, 1 / 4)
"""Of a kind's largest size: dents of 0.025 to 0.1 mm, about the smallest that the shipped backbone shows."""

SPOTS = 16
"""Damage is rendered at this many places, in every size; fewer where frames are large, for the time that it takes."""

_FEWEST_SPOTS, _SPOTS_PX = 8, 16 * 320 * 240


@dataclass(frozen=True, eq=False)
class EditedPresses:
    """frames: uint8 (m, h, w, 3). press: which nominal press each was, int64 (m,). near: the damage and its
    surroundings, bool (m, h, w). names: kind and size of each damage."""

    frames: NDArray[np.uint8]
    press: NDArray[np.int64]
    near: NDArray[np.bool_]
    names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.press)


def edited_presses(
    presses: NominalPresses, profile: SensorProfile, region: Region, rng: np.random.Generator
) -> EditedPresses | None:
    """Each spot in every size of SIZE_SHARES; None without a picture of the free gel, or a contact to damage."""
    if presses.no_contact is None:
        return None
    free = np.asarray(presses.no_contact.mean(axis=0, dtype=np.float64), np.float32)
    station = Station(profile, region, free)
    order = rng.permutation(len(presses)).tolist()
    shown = {k: one for k in order[:SPOTS] if (one := EditedPress(station, presses.frames[k])).contact.any()}
    if not shown:
        return None
    turns = [k for _ in range(SPOTS) for k in shown]
    frames, press, near, names = [], [], [], []
    for number, k in enumerate(islice(turns, _spots(region))):
        spot, kind = _spot(shown[k], rng), list(KINDS)[number % len(KINDS)]
        for share in SIZE_SHARES:
            damage = Damage(kind, share * KINDS[kind].largest_mm, spot)
            frames.append(shown[k].damaged(damage))
            press.append(k)
            near.append(surroundings(damage, station.field))
            names.append(f"{kind} of {share * KINDS[kind].largest_mm:.3g} mm")
    return EditedPresses(np.stack(frames), np.array(press), np.stack(near), tuple(names))


def _spots(region: Region) -> int:
    return max(_FEWEST_SPOTS, min(SPOTS, _SPOTS_PX // (region.width * region.height)))


def _spot(press: EditedPress, rng: np.random.Generator) -> Spot:
    """Anywhere in the contact, in any direction."""
    x, y = (axis[press.contact] for axis in grids(press.station.field))
    pick = rng.integers(len(x))
    return Spot(float(x[pick]), float(y[pick]), float(rng.uniform(0, np.pi)))
