"""A virtual overview camera: it draws a table with a part on it that carries a code.

One picture is made for each press. It does not simulate a lens, light, motion or a bus; use `recorded` for those.
"""

from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator

from edge.core.arrays import U8
from edge.core.errors import DeviceLost
from edge.core.imaging.frames import CameraFrame
from edge.core.plugins import DevicePlugin
from edge.core.ports import Clock, Device, DeviceIdentity, DiscoveredDevice

__all__ = ["VirtualCamera", "VirtualOverview", "VirtualOverviewOptions", "plugin"]

IDENTITY = DeviceIdentity("virtual overview camera", "VIRTUAL1", (640, 480), 1.0)
# Levels of the table, of the part, and the standard deviation of the noise: as a webcam in a lit cell.
TABLE, PART, NOISE = 110, 220, 2.0
LAST_TAG = 586
CODE_PX, MARGIN_PX = 210, 30


class VirtualOverviewOptions(BaseModel, extra="forbid", frozen=True):
    """What lies on the table at each press, in order, and again from the start."""

    parts: list[str] = Field(
        default=["PZ0"],
        min_length=1,
        description="the code of the part at each press; an empty text is the empty table",
    )
    kind: Literal["qr", "apriltag"] = Field(
        default="qr", description="kind of code; an apriltag is a number from 0 to 586 of the family 36h11"
    )

    @model_validator(mode="after")
    def _tags_are_numbers(self) -> "VirtualOverviewOptions":
        for text in self.parts if self.kind == "apriltag" else ():
            if text and not (text.isascii() and text.isdigit() and int(text) <= LAST_TAG):
                raise ValueError(f"an AprilTag of 36h11 is a number from 0 to {LAST_TAG}, found '{text}'")
        return self


class VirtualCamera:
    """A drawn camera as a `Device`."""

    identity = IDENTITY
    on_demand = True

    def __init__(self, options: VirtualOverviewOptions, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._sequence = 0
        self._is_closed = False

    def read(self, deadline_ns: int) -> CameraFrame:
        """The next picture, at once (see `Device.read`)."""
        import cv2

        if self._is_closed:
            raise DeviceLost("the virtual overview camera was closed")
        number = self._sequence
        self._sequence += 1
        text = self._options.parts[number % len(self._options.parts)]
        payload = cv2.imencode(".jpg", _draw(text, self._options.kind, number))[1].tobytes()
        return CameraFrame(payload, self._clock.monotonic_ns(), number, is_on_demand=True)

    def close(self) -> None:
        self._is_closed = True


class VirtualOverview(DevicePlugin[VirtualOverviewOptions]):
    """The plugin."""

    Options = VirtualOverviewOptions

    def discover(self, options: VirtualOverviewOptions) -> list[DiscoveredDevice]:
        return [DiscoveredDevice("drawn by this program", IDENTITY.product, IDENTITY)]

    def open(self, options: VirtualOverviewOptions, clock: Clock) -> Device:
        return VirtualCamera(options, clock)


plugin = VirtualOverview()


def _draw(text: str, kind: str, seed: int) -> U8:
    """Draw a picture, uint8 (h, w). No two are the same: the noise is drawn from the seed."""
    w, h = IDENTITY.mode
    clean = np.full((h, w), TABLE, np.float32)
    if text:
        code = _code(text, kind)
        top, left = (h - len(code)) // 2, (w - len(code)) // 2
        edge = MARGIN_PX
        clean[top - edge : top + len(code) + edge, left - edge : left + len(code) + edge] = PART
        clean[top : top + len(code), left : left + len(code)] = np.minimum(code, PART)
    noise = NOISE * np.random.default_rng(seed).standard_normal(clean.shape, np.float32)
    return np.clip(clean + noise, 0, 255).astype(np.uint8)


def _code(text: str, kind: str) -> Any:
    import cv2

    if kind == "apriltag":
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        return cv2.aruco.generateImageMarker(family, int(text), CODE_PX)
    code = cv2.QRCodeEncoder.create().encode(text)
    return cv2.resize(code, (CODE_PX, CODE_PX), interpolation=cv2.INTER_NEAREST)
