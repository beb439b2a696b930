"""The frames of a sensor that is running: a station's, or a device named on the command line."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from edge import registry
from edge.cli.plugin_options import plugin_options
from edge.config import load_config
from edge.core.contact.settings import ContactSettings
from edge.core.errors import RecordingEnded
from edge.core.gel import DEFAULT_LIMIT_PRESSES
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.ports import Clock, Device
from edge.gateway.acquisition import Acquisition, AcquisitionState, AcquisitionStatus
from edge.gateway.opening import device_opener

__all__ = ["Sensor", "frames_of", "named_device", "station_device"]

WAIT_S = 0.2


@dataclass(frozen=True)
class Sensor:
    """Where frames come from. gel_limit: presses that its gel is rated for."""

    open: Callable[[], Device]
    contact: ContactSettings
    gel_limit: int


def station_device(config: Path, profile: SensorProfile, clock: Clock) -> Sensor:
    """The sensor of a station; its bundle is not needed. Errors: ConfigError."""
    loaded = load_config(config)
    return Sensor(
        device_opener(loaded.device, profile.controls, clock),
        loaded.contact.settings(is_external=False),
        loaded.gel.limit_presses,
    )


def named_device(name: str, given: Sequence[str], clock: Clock) -> Sensor:
    """A device plugin with its options. Errors: ConfigError."""
    plugin = registry.device(name)
    options = plugin_options("devices", name, plugin.Options, given)
    return Sensor(lambda: plugin.open(options, clock), ContactSettings(), DEFAULT_LIMIT_PRESSES)


def frames_of(sensor: Sensor, clock: Clock, say: Callable[[str], None]) -> Iterator[CameraFrame]:
    """Every frame, until a recording that is played ends. A sensor that goes away is waited for, and said.

    Errors: DeviceError where it cannot be opened at the start.
    """
    first: list[Device] = [sensor.open()]

    def opened() -> Device:
        return first.pop() if first else sensor.open()

    def changed(status: AcquisitionStatus) -> None:
        if status.state is AcquisitionState.FAULT:
            say(f"the sensor is away, waiting for it: {status.fault}")
        elif status.state is AcquisitionState.STREAMING and status.reconnects:
            say("the sensor is back")

    with closing(_Unused(first)), Acquisition(opened, clock, changed) as acquisition:
        while True:
            try:
                frame = acquisition.next(WAIT_S)
            except RecordingEnded:
                return
            if frame is not None:
                yield frame


class _Unused:
    """Closes a device that was opened and never taken."""

    def __init__(self, devices: list[Device]) -> None:
        self._devices = devices

    def close(self) -> None:
        for device in self._devices:
            device.close()
