"""Which of the devices on the bus is a GelSight Mini.

Ref: USB dumps in public reports (firmware_notes/gelsight_mini.md). The id 0c45:636d belongs to a camera bridge that
webcams share, so it only selects candidates; the product string decides.
"""

from dataclasses import dataclass
from typing import Any

import usb.core
import usb.util

from edge.core.errors import DeviceNotFound
from edge.core.ports import DeviceIdentity, DiscoveredDevice
from edge.core.sentence import Sentence
from plugins.devices.uvc.uvc import CLASS_VIDEO, SUBCLASS_STREAMING, VideoMode, mjpeg_modes

__all__ = [
    "PRODUCT_ID",
    "PRODUCT_PREFIX",
    "VENDOR_ID",
    "SensorOnBus",
    "choose",
    "discover",
    "refusal",
    "streaming_modes",
]

VENDOR_ID, PRODUCT_ID = 0x0C45, 0x636D
PRODUCT_PREFIX = "GelSight Mini"


@dataclass(frozen=True)
class SensorOnBus:
    """A pyusb device and its identification."""

    device: Any
    discovered: DiscoveredDevice


def refusal(product: str) -> str | None:
    """Say why a device with the sensor's USB id is not a sensor, or None when it is one."""
    if product.startswith(PRODUCT_PREFIX):
        return None
    return (
        f"a camera with the sensor's USB id {VENDOR_ID:04x}:{PRODUCT_ID:04x}, but its product is "
        f"'{product}' and not '{PRODUCT_PREFIX} ...'; that id is shared by webcams"
    )


def discover(backend: Any) -> list[SensorOnBus]:
    """Everything with the sensor's USB id, in the order of bus, port and address."""
    devices = usb.core.find(find_all=True, backend=backend, idVendor=VENDOR_ID, idProduct=PRODUCT_ID)
    seen = [SensorOnBus(device, _look(device)) for device in devices]
    return sorted(
        seen, key=lambda sensor: (sensor.device.bus, sensor.device.port_numbers or (), sensor.device.address)
    )


def choose(seen: list[SensorOnBus], serial: str | None) -> SensorOnBus:
    """The sensor with this serial, or the only one. Errors: DeviceNotFound with every device that was seen instead."""
    sensors = [sensor for sensor in seen if sensor.discovered.identity is not None]
    chosen = [sensor for sensor in sensors if serial in (None, _serial(sensor))]
    if len(chosen) == 1:
        return chosen[0]
    if len(chosen) > 1:
        raise DeviceNotFound(
            f"{len(chosen)} sensors are plugged in ({', '.join(map(_serial, chosen))}); name one by its serial, "
            "the device's option `serial`"
        )
    wanted = Sentence(f"no GelSight Mini with serial {serial}") if serial else Sentence("no GelSight Mini")
    others = [f"{_serial(sensor)} at {sensor.discovered.place}" for sensor in sensors]
    others += [
        f"{sensor.discovered.place}: {sensor.discovered.refusal}"
        for sensor in seen
        if sensor.discovered.refusal
    ]
    raise DeviceNotFound(
        Sentence(
            f"{wanted} is plugged in; seen: {'; '.join(others) or Sentence('no device with its USB id')}"
        )
    )


def streaming_modes(device: Any) -> tuple[int, list[VideoMode]]:
    """(number of the streaming interface, its MJPEG modes). Errors: ValueError when it has none."""
    for interface in (interface for configuration in device for interface in configuration):
        is_streaming = (
            interface.bInterfaceClass == CLASS_VIDEO and interface.bInterfaceSubClass == SUBCLASS_STREAMING
        )
        if is_streaming and (modes := mjpeg_modes(bytes(interface.extra_descriptors))):
            return int(interface.bInterfaceNumber), modes
    raise ValueError("it has no MJPEG video mode")


def _serial(one: SensorOnBus) -> str:
    return one.discovered.identity.serial if one.discovered.identity else ""


def _look(device: Any) -> DiscoveredDevice:
    place = f"bus {device.bus} port {'.'.join(map(str, device.port_numbers or ()))} address {device.address}"
    try:
        product = usb.util.get_string(device, device.iProduct) or ""
        why = refusal(product)
        if why:
            return DiscoveredDevice(place, product, refusal=why)
        # Else the end of the product string, without its dash: `... 2BNN-4ZE7` is 2BNN4ZE7.
        serial = usb.util.get_string(device, device.iSerialNumber) or product.split()[-1].replace("-", "")
        mode = largest_mode(streaming_modes(device)[1])
    except (usb.core.USBError, ValueError) as error:
        # pyusb answers a missing permission with "The device has no langid", a ValueError.
        return DiscoveredDevice(
            place,
            "",
            refusal=f"its descriptors cannot be read ({error}); run `gelgate station install-service` as root",
        )
    finally:
        usb.util.dispose_resources(device)
    identity = DeviceIdentity(product, serial, (mode.width, mode.height), mode.nominal_fps)
    return DiscoveredDevice(place, product, identity)


def largest_mode(modes: list[VideoMode]) -> VideoMode:
    """The mode with most pixels; the first of equals."""
    return max(modes, key=lambda mode: mode.width * mode.height)
