"""A camera whose maker's program saves every frame as a numbered JPEG in a folder."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, Field

from edge.core.errors import DeviceLost, DeviceNotFound, DeviceStalled, FrameCorrupt
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import Freshness, damage
from edge.core.plugins import DevicePlugin
from edge.core.ports import Clock, DeviceIdentity, DiscoveredDevice


class DeviceOptions(BaseModel, extra="forbid", frozen=True):
    """The keys of its table in the configuration."""

    folder: Path = Field(description="where the maker's program saves 000001.jpg and so on")
    size: tuple[int, int] = Field(default=(320, 240), description="width and height of a frame")


class Device:
    """It delivers camera frames as they arrive, each once. gelgate opens it again after a fault."""

    def __init__(self, options: DeviceOptions, clock: Clock) -> None:
        self.identity = identify(options)
        self._folder, self._clock, self._freshness = options.folder, clock, Freshness()
        self._last, self._sequence, self._is_closed = "", -1, False

    def read(self, deadline_ns: int) -> CameraFrame:
        """Wait for the next new frame. Errors: DeviceStalled, DeviceLost, FrameCorrupt."""
        while self._folder.is_dir() and not self._is_closed:
            new = sorted(path for path in self._folder.glob("*.jpg") if path.name > self._last)
            if new:
                payload, self._last, self._sequence = new[0].read_bytes(), new[0].name, self._sequence + 1
                if fault := damage(payload):
                    raise FrameCorrupt(f"{new[0]}: {fault}")
                if self._freshness.is_new(payload):
                    return CameraFrame(payload, self._clock.monotonic_ns(), self._sequence)
            elif self._clock.monotonic_ns() >= deadline_ns:
                raise DeviceStalled(f"no new frame in {self._folder}; is the maker's program running?")
            else:
                self._clock.sleep(0.01)
        raise DeviceLost(f"the folder {self._folder} is gone, or the camera was closed")

    def close(self) -> None:
        self._is_closed = True


def identify(options: DeviceOptions) -> DeviceIdentity:
    """Presses on a gel are counted for the serial: it must be another one for each sensor."""
    return DeviceIdentity("watched folder", options.folder.name, options.size, 20.0)


class Plugin(DevicePlugin[DeviceOptions]):
    """What the entry point names."""

    Options = DeviceOptions

    def discover(self, options: DeviceOptions) -> Sequence[DiscoveredDevice]:
        """List what `gelgate devices` prints."""
        identity = identify(options)
        device = DiscoveredDevice(str(options.folder), identity.product, identity)
        return [device] if options.folder.is_dir() else []

    def open(self, options: DeviceOptions, clock: Clock) -> Device:
        """Open it. Errors: DeviceNotFound."""
        if not options.folder.is_dir():
            raise DeviceNotFound(f"there is no folder {options.folder}; start the maker's program")
        return Device(options, clock)


plugin = Plugin()
