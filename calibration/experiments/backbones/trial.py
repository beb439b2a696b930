"""One trial of a backbone: the presses of one position that a detector learns, and the presses that it scores."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

__all__ = ["FORMAT", "PROFILE", "REGION", "Trial"]

# Of the evaluation's file; 1 and 2 had other sets.
FORMAT = 3

PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)


@dataclass(frozen=True)
class Trial:
    """The presses that a detector learns, and those that it scores.

    is_other, is_relit: bool (n,), None for no such frames: presses of another object by the same sensor, and sound
    presses under another light.
    """

    name: str
    nominal: NominalPresses
    frames: NDArray[np.uint8]
    """uint8 (n, h, w, 3)."""
    masks: NDArray[np.bool_]
    """bool (n, h, w), all False for an undamaged press."""
    is_other: NDArray[np.bool_] | None = None
    is_relit: NDArray[np.bool_] | None = None
    alpha: float | None = None
    """The false-alarm rate of the fitted limit; None where no limit is fitted and no measure at it is given."""

    @property
    def is_own(self) -> NDArray[np.bool_]:
        """The sound and the damaged presses of the learnt object under its light, bool (n,)."""
        apart = [kind for kind in (self.is_other, self.is_relit) if kind is not None]
        return np.asarray(~np.logical_or.reduce([np.zeros(len(self.frames), np.bool_), *apart]), np.bool_)
