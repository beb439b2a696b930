"""An OAK (Luxonis) as overview camera, by `depthai` 3: its colour camera alone, nothing is computed on it.

Ref: docs.luxonis.com, DepthAI v3: Camera, ReplayVideo, MessageQueue. Seen with depthai 3.12: films replayed on the host
(option `film`), and the search without a device (0.5 s). Not yet seen: an OAK on a physical bus.
"""

import os
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, Field

from edge.core.errors import (
    DeviceBusy,
    DeviceLost,
    DeviceNotFound,
    DeviceStalled,
    FrameCorrupt,
    RecordingEnded,
    RecordingError,
)
from edge.core.imaging.frames import CameraFrame
from edge.core.plugins import DevicePlugin
from edge.core.ports import Clock, Device, DeviceIdentity, DiscoveredDevice
from edge.extras import needs

__all__ = ["QUIET", "Oak", "OakCamera", "OakOptions", "plugin", "quiet_depthai"]

JPEG_QUALITY: Final = 85
PRODUCT: Final = "OAK"

# Variables of depthai 3.12: a gateway sends only what its configuration says, telemetry is on by default.
QUIET: Final = {
    "DEPTHAI_TELEMETRY": "0",
    "DEPTHAI_DISABLE_CRASHDUMP_COLLECTION": "1",
    "DEPTHAI_CRASHDUMP": "0",
    "DEPTHAI_DISABLE_FEEDBACK": "1",
    "DEPTHAI_DISABLE_STARTUP_NOTIFICATIONS": "1",
    "DEPTHAI_ZOO_INTERNET_CHECK": "0",
    # Milliseconds that it looks for a device that vanished between search and opening; 10 s by default.
    "DEPTHAI_SEARCH_TIMEOUT": "1000",
    # Its handlers end the process at a file that may not grow, which Python reports as an error, and print to it.
    "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0",
    # Its warnings go to the standard output, where results of verbs go.
    "DEPTHAI_LEVEL": "error",
}


def quiet_depthai() -> Any:
    """The module. It reads these variables when it is imported. Errors: ConfigError where it is not installed."""
    needs("oak", "the overview camera 'oak'")
    os.environ.update(QUIET)
    import depthai

    return depthai


class OakOptions(BaseModel, extra="forbid", frozen=True):
    """Which OAK, and the size of its pictures."""

    serial: str | None = Field(
        default=None, description="its device id, if several are there: `gelgate devices`"
    )
    socket: str = Field(
        default="CAM_A", pattern="^CAM_[A-J]$", description="board socket of the colour camera"
    )
    width: int = Field(default=1280, ge=64, le=8192, description="pixels")
    height: int = Field(default=720, ge=64, le=8192, description="pixels")
    fps: float = Field(default=5.0, ge=0.5, le=60, description="pictures a second")
    film: Path | None = Field(
        default=None,
        description="play this film instead of a camera, once, at `fps`: for trials without an OAK",
    )


class OakCamera:
    """A running pipeline as a `Device`. Pictures come as JPEG, encoded here."""

    def __init__(
        self, identity: DeviceIdentity, pipeline: Any, queue: Any, clock: Clock, *, is_film: bool
    ) -> None:
        self.identity = identity
        self._pipeline, self._queue, self._clock, self._is_film = pipeline, queue, clock, is_film
        self._sequence = 0
        self._gone: DeviceLost | RecordingEnded | None = None

    def read(self, deadline_ns: int) -> CameraFrame:
        import cv2

        if self._gone is not None:
            raise self._gone
        left_s = max(0.0, (deadline_ns - self._clock.monotonic_ns()) / 1e9)
        try:
            message = self._queue.get(timedelta(seconds=left_s))
        except (RuntimeError, self._queue.QueueException) as error:  # a broken XLink, or a closed queue
            self._gone = (
                RecordingEnded(f"{self._name} has ended after {self._sequence} pictures")
                if self._is_film
                else DeviceLost(f"{self._name} is gone ({error}); it is opened again")
            )
            raise self._gone from error
        if message is None:
            raise DeviceStalled(f"{self._name} gave no picture before the deadline")
        self._sequence += 1
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        try:
            jpeg = cv2.imencode(".jpg", message.getCvFrame(), quality)[1].tobytes()
        except (RuntimeError, cv2.error) as error:
            raise FrameCorrupt(f"{self._name}, frame {self._sequence - 1}: {error}") from error
        return CameraFrame(jpeg, self._clock.monotonic_ns(), self._sequence - 1)

    @property
    def _name(self) -> str:
        return f"{self.identity.product} {self.identity.serial}"

    def close(self) -> None:
        self._gone = self._gone or DeviceLost(f"{self._name} was closed")
        self._queue.close()
        with suppress(RuntimeError):  # of a camera that is gone
            self._pipeline.stop()


class Oak(DevicePlugin[OakOptions]):
    """The plugin."""

    Options = OakOptions

    def discover(self, options: OakOptions) -> list[DiscoveredDevice]:
        """List the cameras. Errors: ConfigError without depthai. The search takes half a second."""
        if options.film is not None:
            return [DiscoveredDevice(str(options.film), PRODUCT, _identity(str(options.film), options))]
        cameras = quiet_depthai().Device.getAllAvailableDevices()
        return [DiscoveredDevice(str(c.name), PRODUCT, _identity(c.deviceId, options)) for c in cameras]

    def open(self, options: OakOptions, clock: Clock) -> Device:
        """Open the camera or the film. Errors: ConfigError, DeviceNotFound, DeviceBusy, RecordingError."""
        dai = quiet_depthai()
        return _film(dai, options, clock) if options.film is not None else _camera(dai, options, clock)


plugin = Oak()


def _identity(serial: str, options: OakOptions) -> DeviceIdentity:
    return DeviceIdentity(PRODUCT, serial, (options.width, options.height), options.fps)


def _camera(dai: Any, options: OakOptions, clock: Clock) -> OakCamera:
    try:
        info = _choose(dai.Device.getAllAvailableDevices(), options.serial)
        device = dai.Device(info)
        pipeline = dai.Pipeline(device)
        camera = pipeline.create(dai.node.Camera).build(getattr(dai.CameraBoardSocket, options.socket))
        size = (options.width, options.height)
        queue = camera.requestOutput(size, fps=options.fps).createOutputQueue(1, False)
        pipeline.start()
    except RuntimeError as error:
        raise DeviceBusy(
            f"{PRODUCT} {options.serial or 'camera'} does not start ({error}); end other programs that use it, or "
            "plug it in again"
        ) from error
    return OakCamera(_identity(info.deviceId, options), pipeline, queue, clock, is_film=False)


def _choose(cameras: Any, serial: str | None) -> Any:
    """Choose the one camera that fits, without waiting for it. Errors: DeviceNotFound with those that are there."""
    fitting = [camera for camera in cameras if serial in (None, camera.deviceId)]
    if len(fitting) == 1:
        return fitting[0]
    seen = ", ".join(camera.deviceId for camera in cameras) or "none"
    wanted = "one OAK" if serial is None else f"the OAK {serial}"
    raise DeviceNotFound(
        f"{wanted} is expected, seen: {seen}; plug it in, check its cable and power, or name its serial"
    )


def _film(dai: Any, options: OakOptions, clock: Clock) -> OakCamera:
    film = options.film
    if film is None or not film.is_file():
        raise RecordingError(f"film {film} is no file; name one that OpenCV can read, such as an mp4")
    pipeline = dai.Pipeline(False)
    replay = pipeline.create(dai.node.ReplayVideo)
    replay.setReplayVideoFile(str(film))
    replay.setLoop(False)
    replay.setFps(options.fps)
    replay.setOutFrameType(dai.ImgFrame.Type.BGR888i)
    replay.setSize(options.width, options.height)
    queue = replay.out.createOutputQueue(1, True)
    pipeline.start()
    return OakCamera(_identity(str(film), options), pipeline, queue, clock, is_film=True)
