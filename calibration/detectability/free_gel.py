"""The gel without contact, with which a press is compared: a picture of it, or the colours of a known unit."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.fitting.nominal_presses import NominalPresses
from calibration.simulator.field_of_view import F32, Field
from calibration.simulator.sensor_appearance import SENSORS, background
from edge.core.errors import DatasetError
from edge.core.imaging.sensor_check import colour_cells, colour_distance
from edge.model.bundle import Bundle

__all__ = ["free_gel"]

_CELLS = (8, 8)
# Presses of one unit lie within this share of the light of its free gel, those of other units at 3 % to 37 %
# (docs/bundle.md); a unit nearer than this gives the same slopes within the accuracy of the response.
_NEAR_UNIT = 0.1


def free_gel(bundle: Bundle, presses: NominalPresses) -> tuple[F32, str | None]:
    """The free gel in the region, float32 (h, w, 3), and a warning where it is not of this station.

    From the presses' own pictures of it, else the bundle's, else from the nearest known unit. Errors: DatasetError
    where no unit is near.
    """
    if presses.no_contact is not None:
        return np.asarray(presses.no_contact.mean(axis=0, dtype=np.float64), np.float32), None
    if bundle.free_view is not None:
        view = cv2.resize(
            bundle.free_view.astype(np.float32), bundle.profile.size, interpolation=cv2.INTER_LINEAR
        )
        return np.ascontiguousarray(bundle.region.crop(np.asarray(view, np.float32))), None
    return _of_nearest_unit(bundle, presses)


def _of_nearest_unit(bundle: Bundle, presses: NominalPresses) -> tuple[F32, str]:
    whole = Field(bundle.profile.size, bundle.profile.mm_per_pixel)
    units = {
        name: np.ascontiguousarray(bundle.region.crop(background(unit, whole).transpose(1, 2, 0)))
        for name, unit in SENSORS.items()
    }
    mean = presses.frames.mean(axis=0, dtype=np.float64)
    away = {name: colour_distance(_cells(mean), _cells(unit)) for name, unit in units.items()}
    nearest = min(away, key=away.__getitem__)
    if away[nearest] > _NEAR_UNIT:
        raise DatasetError(
            f"neither the presses nor bundle {bundle.where} have a picture of the free gel, and the nearest unit whose "
            f"light is known differs by {away[nearest]:.0%} of the light; give a picture of it with --no-contact"
        )
    return units[nearest], (
        f"there is no picture of the free gel: the colours of the known unit '{nearest}' stand for it, which differ by "
        f"{away[nearest]:.1%} of the light; give one with --no-contact for exact places of contact"
    )


def _cells(picture: NDArray[np.floating]) -> NDArray[np.float64]:
    return colour_cells(np.clip(np.rint(picture), 0, 255).astype(np.uint8), _CELLS)
