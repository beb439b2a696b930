"""A bundle of the tiny detector that registers its presses, learnt from parts that a formula puts anywhere."""

import dataclasses
from functools import cache
from unittest import mock

import numpy as np
import tiny
import turned_parts as parts
from numpy.typing import NDArray
from tiny_fit import config

from calibration.fitting.damage import damaged_presses
from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.pose.pose_decision import Register
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

PROFILE = SensorProfile("turned", (parts.SIDE, parts.SIDE), (0.0, 0.0), (parts.SIDE, parts.SIDE), 1, 15.77)


class PlaceDetector(tiny.TinyDetector):
    """The tiny detector, which does compare place with place."""

    compares_places = True


def nominal(frames: NDArray[np.uint8], **changes: object) -> NominalPresses:
    whole = NominalPresses(
        frames, tuple(f"press {k}" for k in range(len(frames))), no_contact=parts.free_gel()[None]
    )
    return dataclasses.replace(whole, **changes)  # type: ignore[arg-type]


def fitted(presses: NominalPresses, register: Register = "never", **changes: object) -> Fitted:
    whole = config(
        part="block",
        profile=PROFILE,
        region=Region(0, 0, parts.SIDE, parts.SIDE),
        detector=PlaceDetector(),
        register=register,
    )
    # Damage at as many places as of a large picture: at more it is half of the time of such a fit.
    with mock.patch.object(damaged_presses, "SPOTS", 8):
        return fit_files(presses, dataclasses.replace(whole, **changes), created="2026-01-01")  # type: ignore[arg-type]


@cache
def registered() -> Fitted:
    """Learnt from 14 presses of a part that a hand put down."""
    return fitted(nominal(parts.anywhere(parts.BLOCK, 14)[1]), "auto")
