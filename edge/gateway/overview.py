"""The overview camera of a running station: its newest still when a contact begins, and what that says of the part."""

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DeviceError, FrameCorrupt
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import kind
from edge.core.overview.rules import OverviewRules, OverviewView
from edge.core.ports import Clock
from edge.gateway.acquisition import Acquisition, AcquisitionState

__all__ = ["Overview", "still_of"]

# The loop waits this long for a still when the camera streams and none has come: less than the 0.8 s that the sensor's
# frames may wait.
WAIT_S: Final = 0.25
# The largest still that is decoded: twice the pixels of the largest sensor of an OAK.
MOST_PIXELS: Final = 100_000_000
JPEG_QUALITY: Final = 85


class Overview:
    """Looks at the part before each press. The loop uses it; its camera is read by a thread of its own.

    max_age_s: an older still says nothing of this press. max_side_px: larger stills are made smaller before they are
    read and published.
    """

    def __init__(
        self,
        camera: Acquisition,
        rules: OverviewRules,
        clock: Clock,
        *,
        max_age_s: float,
        max_side_px: int,
    ) -> None:
        self.camera, self.rules, self._clock = camera, rules, clock
        self._max_age_s, self._max_side_px = max_age_s, max_side_px
        self._frame: CameraFrame | None = None
        self._grey: NDArray[np.uint8] | None = None
        self._view: OverviewView | None = None

    def start(self) -> None:
        """Begin to connect and read, in the background."""
        self.camera.start()

    def close(self) -> None:
        """Stop reading and release the camera; may be called again."""
        self.camera.close()

    def begin(self) -> OverviewView:
        """A contact began: look at the part now, before the press is judged."""
        self._view = self._look()
        return self._view

    def take(self) -> OverviewView:
        """What was seen when this press began; asked once for each press."""
        view, self._view = self._view or self._look(), None
        return view

    def _look(self) -> OverviewView:
        before, seen = self._frame, self._grey
        try:
            self._frame = self._newest()
            if self._frame is None:
                fault = self.camera.status.fault
                return OverviewView(None, fault=fault or "the overview camera has given no new picture")
            still, self._grey = still_of(self._frame, self._max_side_px)
            # The noise of a camera changes every picture: an equal one in a later frame is a camera that hangs.
            if self._frame is not before and seen is not None and np.array_equal(seen, self._grey):
                self._frame = None
                return OverviewView(None, fault="the overview camera gives one picture again and again")
            return self.rules.look(still, self._grey)
        except DeviceError as error:  # a broken picture, or a recording that is over
            self._frame = None
            return OverviewView(None, fault=str(error))

    def _newest(self) -> CameraFrame | None:
        """The next frame of those made on demand, else the newest. Waits only for a camera that may soon give one."""
        waiting = self.camera.next(0) or self._frame_of_before()
        if waiting is not None and self._is_fresh(waiting):
            return waiting
        if self.camera.status.state not in (AcquisitionState.CONNECTING, AcquisitionState.STREAMING):
            return None
        return self.camera.next(WAIT_S)

    def _frame_of_before(self) -> CameraFrame | None:
        """The still of an earlier press, while the camera has given no newer one."""
        return None if self._frame is None or self._frame.is_on_demand else self._frame

    def _is_fresh(self, frame: CameraFrame) -> bool:
        return frame.is_on_demand or self._clock.monotonic_ns() - frame.timestamp_ns <= self._max_age_s * 1e9


def still_of(frame: CameraFrame, max_side_px: int) -> tuple[bytes, NDArray[np.uint8]]:
    """The JPEG to publish, and the same in grey, uint8 (h, w). A JPEG that is small enough is published untouched.

    Errors: FrameCorrupt for a picture that cannot be read.
    """
    size = frame.size
    if frame.damage is not None or size is None:
        raise FrameCorrupt(f"the overview camera's frame {frame.sequence} is {frame.damage or 'no picture'}")
    if size[0] * size[1] > MOST_PIXELS:
        raise FrameCorrupt(
            f"the overview camera's frame {frame.sequence} has {size[0]}x{size[1]} pixels, at most {MOST_PIXELS} are "
            "read; choose a smaller mode"
        )
    if kind(frame.payload) == "jpg" and max(size) <= max_side_px:
        return frame.payload, _decoded(frame, cv2.IMREAD_GRAYSCALE)
    colour = _decoded(frame, cv2.IMREAD_COLOR)
    scale = min(1.0, max_side_px / max(size))
    small = cv2.resize(colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return jpeg, np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)


def _decoded(frame: CameraFrame, flags: int) -> Any:
    """Errors: FrameCorrupt."""
    picture = cv2.imdecode(np.frombuffer(frame.payload, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None:
        raise FrameCorrupt(f"the overview camera's frame {frame.sequence} cannot be decoded")
    return picture
