"""The GelSight Mini on a real USB bus: found by pyusb, streamed by the kernel (v4l2) or directly (uvc).

References, and what is seen, measured, read or assumed: firmware_notes/gelsight_mini.md. Seen on a virtual camera under
a real kernel (tests/hardware/kernel_lab): both stream paths work, are unplugged and come back. Not yet seen with this
program: a sensor on a physical bus.
"""

from contextlib import ExitStack
from typing import Literal

import usb.core
import usb.util
from pydantic import BaseModel, Field

from edge.core.plugins import DevicePlugin, RecordsDialogue, Resettable
from edge.core.ports import Clock, Device, DiscoveredDevice
from plugins.devices.uvc.controls import report_unset
from plugins.devices.uvc.faults import guarded
from plugins.devices.uvc.identity import SensorOnBus, choose, discover
from plugins.devices.uvc.libusb import LibusbBackend, get_backend
from plugins.devices.uvc.lock import SensorLock
from plugins.devices.v4l2.controls import pin_v4l2_controls
from plugins.devices.v4l2.sensor import V4l2Sensor, capture_node, open_capture

__all__ = ["GelsightMini", "GelsightMiniOptions", "plugin"]


class GelsightMiniOptions(BaseModel, extra="forbid", frozen=True):
    """Which sensor, and how it is read."""

    serial: str | None = Field(
        default=None,
        pattern="^[A-Z0-9]{8}$",
        description="which sensor, if several are plugged in: the end of its product string, without the dash",
    )
    stream: Literal["v4l2", "uvc"] = Field(
        default="v4l2",
        description="v4l2: through the kernel; uvc: through libusb, which takes the sensor from the kernel while open",
    )
    controls: dict[str, int] = Field(
        default_factory=dict,
        description="camera controls to pin, V4L2 names (old or new) to values; the sensor profile usually has them",
    )


class GelsightMini(
    DevicePlugin[GelsightMiniOptions], Resettable[GelsightMiniOptions], RecordsDialogue[GelsightMiniOptions]
):
    """The plugin."""

    Options = GelsightMiniOptions

    def discover(self, options: GelsightMiniOptions) -> list[DiscoveredDevice]:
        """List the sensors on the bus. Errors: DeviceNotFound when libusb cannot be loaded."""
        return [sensor.discovered for sensor in discover(get_backend())]

    def open(self, options: GelsightMiniOptions, clock: Clock) -> Device:
        """Open the sensor. Errors: DeviceNotFound, DeviceBusy, DeviceLost, DeviceStalled."""
        backend = get_backend()
        sensor = choose(discover(backend), options.serial)
        if options.stream == "uvc":
            from plugins.devices.uvc.stream import UvcSensor  # a sensor mostly goes through the kernel

            return UvcSensor.open(backend, sensor, clock, controls=options.controls)
        return _open_v4l2(backend, sensor, options, clock)

    def reset(self, options: GelsightMiniOptions) -> str:
        """Reset the sensor as a re-plug does; returns which one. Errors: DeviceNotFound, DeviceBusy, DeviceLost."""
        sensor = choose(discover(get_backend()), options.serial)
        who = f"{sensor.discovered.product} at {sensor.discovered.place}"
        with guarded(who):
            sensor.device.reset()
            usb.util.dispose_resources(sensor.device)
        return who

    def record_dialogue(self, options: GelsightMiniOptions, clock: Clock) -> list[str]:
        """Through libusb, whatever `stream` says. Errors: DeviceNotFound."""
        from plugins.devices.uvc.dialogue import record_dialogue

        return record_dialogue(get_backend(), options.serial, clock)


plugin = GelsightMini()


def _open_v4l2(
    backend: LibusbBackend, found: SensorOnBus, options: GelsightMiniOptions, clock: Clock
) -> V4l2Sensor:
    identity = found.discovered.identity
    if identity is None:
        raise ValueError(f"{found.discovered.place} is not a sensor")
    with ExitStack() as on_failure:
        lock = SensorLock(identity.serial)
        on_failure.callback(lock.close)
        node = capture_node(identity.serial)
        capture = open_capture(node.path, identity.mode)
        on_failure.callback(capture.release)
        with guarded(identity.product):
            unset = pin_v4l2_controls(node.path, options.controls)
        on_failure.pop_all()
    report_unset(identity.serial, unset)
    sensor = V4l2Sensor(
        identity, capture, clock, is_present=lambda: _is_on_bus(backend, identity.serial), on_close=lock.close
    )
    sensor.unset_controls = unset
    return sensor


def _is_on_bus(backend: LibusbBackend, serial: str) -> bool:
    return any(
        sensor.discovered.identity and sensor.discovered.identity.serial == serial
        for sensor in discover(backend)
    )
