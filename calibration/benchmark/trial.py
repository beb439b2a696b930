"""One trial of a backbone: what a detector learns of one position of one part, and what it then scores."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.nominal_presses import NominalPresses
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

__all__ = ["FORMAT", "PROFILE", "REGION", "Trial"]

# Of the evaluation's file; 1 and 2 had other sets.
FORMAT = 3

PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)


@dataclass(frozen=True)
class Trial:
    """What a detector learns, and what it then scores.

    frames: uint8 (n, h, w, 3). masks: bool (n, h, w), all False where nothing was done to the press. is_foreign: bool
    (n,), frames of another kind of sensor, which have no mask and count as neither sound nor damaged.
    """

    name: str
    nominal: NominalPresses
    frames: NDArray[np.uint8]
    masks: NDArray[np.bool_]
    is_foreign: NDArray[np.bool_]
