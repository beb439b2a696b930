"""The values that flow from the camera to the detector."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["CameraFrame", "Picture"]


@dataclass(frozen=True)
class CameraFrame:
    """One frame exactly as the camera sent it.

    payload: the JPEG (or PNG) bytes, untouched, so that what is archived is what was seen.
    timestamp_ns: monotonic nanoseconds at arrival. sequence: rises by one per frame that the device delivered.
    is_on_demand: made when it was asked for; its time is that of the recording, and its age says nothing.
    """

    payload: bytes
    timestamp_ns: int
    sequence: int
    is_on_demand: bool = False


@dataclass(frozen=True)
class Picture:
    """A decoded frame in the geometry of a sensor profile.

    rgb: uint8, (h, w, 3), channel order red, green, blue. The other fields are those of its camera frame.
    """

    rgb: NDArray[np.uint8]
    timestamp_ns: int
    sequence: int

    def __post_init__(self) -> None:
        if self.rgb.ndim != 3 or self.rgb.shape[2] != 3 or self.rgb.dtype != np.uint8:
            raise ValueError(f"a picture is uint8 (h, w, 3), found {self.rgb.dtype} {self.rgb.shape}")
