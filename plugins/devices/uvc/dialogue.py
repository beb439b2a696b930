"""A dialogue on USB: what the driver asked a sensor and what it answered, kept as lines of JSON.

The first line says where it was recorded and what the driver made of it; each line after it is one call of pyusb's
backend interface. Of a frame the header is kept, and both ends of each packet: no picture can be seen in it.

Ref: pyusb 1.3.1, usb/backend/__init__.py.
"""

import json
import platform
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any, Final

import usb.core

from edge.core.errors import GelgateError
from edge.core.imaging.known_profiles import MINI_CONTROLS
from edge.core.ports import Clock
from plugins.devices.uvc.identity import PRODUCT_ID, VENDOR_ID, SensorOnBus, choose, discover
from plugins.devices.uvc.payload import Packet
from plugins.devices.uvc.stream import PacketStream, UvcSensor

__all__ = ["DialogueRecorder", "listen", "record_dialogue"]

VERSION: Final = 1
FRAMES: Final = 5
_DEADLINE_NS: Final = 5_000_000_000
_KEPT: Final = 8
"""Bytes at either end of what a packet carries: two frames stay different, and a JPEG's end is there."""

_START_OF_SCAN: Final = b"\xff\xda"
_DESCRIPTORS: Final = {
    "get_device_descriptor": "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol "
    "bMaxPacketSize0 idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations bus address "
    "port_number port_numbers speed",
    "get_configuration_descriptor": "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue "
    "iConfiguration bmAttributes bMaxPower extra_descriptors",
    "get_interface_descriptor": "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints "
    "bInterfaceClass bInterfaceSubClass bInterfaceProtocol iInterface extra_descriptors",
    "get_endpoint_descriptor": "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval "
    "bRefresh bSynchAddress extra_descriptors",
}


class DialogueRecorder:
    """A pyusb backend that passes every call on to another one, and keeps it."""

    def __init__(self, backend: Any) -> None:
        self.lines: list[str] = []
        self._backend = backend
        self._numbers: dict[tuple[int, int], int] = {}
        self._handles: dict[int, tuple[object, int]] = {}

    def enumerate_devices(self) -> Iterator[Any]:
        """List the sensors; other kinds of devices are nobody's business."""
        for device in self._backend.enumerate_devices():
            seen = self._backend.get_device_descriptor(device)
            if (seen.idVendor, seen.idProduct) == (VENDOR_ID, PRODUCT_ID):
                yield device

    def open_device(self, device: Any) -> Any:
        number = self._number(device)
        handle = self._keep(
            ["open_device", number], lambda: self._backend.open_device(device), lambda _: None
        )
        self._handles[id(handle)] = handle, number
        return handle

    def close_device(self, handle: Any) -> None:
        """Close it. The call is not kept: Python closes when it collects."""
        self._backend.close_device(handle)

    def get_parent(self, device: Any) -> None:
        return None

    def ctrl_transfer(
        self, handle: Any, kind: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        is_in = bool(kind & 0x80)
        words = [*self._words("ctrl_transfer", handle), kind, request, value, index]
        count: int = self._keep(
            [*words, len(data) if is_in else bytes(data).hex()],
            lambda: self._backend.ctrl_transfer(handle, kind, request, value, index, data, timeout),
            lambda count: bytes(data[:count]).hex() if is_in else count,
        )
        return count

    def packet_stream(self, handle: Any, endpoint: int, packet_bytes: int) -> PacketStream:
        words = [*self._words("packet_stream", handle), endpoint, packet_bytes]
        stream: Any = self._keep(
            words, lambda: self._backend.packet_stream(handle, endpoint, packet_bytes), lambda _: None
        )
        read = stream.read
        stream.read = lambda timeout_ms: self._keep(
            ["packets"], lambda: read(timeout_ms), lambda batch: [_shorten(packet) for packet in batch]
        )
        return stream  # type: ignore[no-any-return]  # of a backend without types

    def __getattr__(self, name: str) -> Any:
        """Any other call: of the device or its handle, and numbers."""
        call = getattr(self._backend, name)

        def ask(subject: Any, *numbers: int) -> Any:
            answer = _as_json(_DESCRIPTORS[name]) if name in _DESCRIPTORS else lambda value: value
            return self._keep(
                [*self._words(name, subject), *numbers], lambda: call(subject, *numbers), answer
            )

        return ask

    def _words(self, name: str, subject: Any) -> list[Any]:
        _, number = self._handles.get(id(subject), (None, -1))
        return [name, number if number >= 0 else self._number(subject)]

    def _number(self, device: Any) -> int:
        seen = self._backend.get_device_descriptor(device)
        return self._numbers.setdefault((seen.bus, seen.address), len(self._numbers))

    def _keep(self, words: list[Any], call: Callable[[], Any], answer: Callable[[Any], Any]) -> Any:
        try:
            value = call()
        except usb.core.USBError as error:
            text = {"error": [error.strerror, error.backend_error_code, error.errno]}
            self.lines.append(json.dumps([*words, text]))
            raise
        except IndexError:  # past the last descriptor
            self.lines.append(json.dumps([*words, {"error": []}]))
            raise
        self.lines.append(json.dumps([*words, answer(value)]))
        return value


def record_dialogue(
    backend: Any, serial: str | None, clock: Clock, *, lock_name: str | None = None
) -> list[str]:
    """Open a sensor, set its controls, read some frames and close it; returns the lines of the file.

    Errors: DeviceNotFound. What goes wrong after the sensor was found is a part of the dialogue.
    """
    recorder = DialogueRecorder(backend)
    heard = listen(recorder, choose(discover(recorder), serial), clock, lock_name=lock_name)
    kernel = ".".join(platform.release().split(".")[:2])
    system = f"{platform.system()} {kernel} {platform.machine()}"
    by = {"dialogue": VERSION, "program": f"gelgate {version('gelgate')}", "system": system}
    return [json.dumps({**by, "heard": heard}), *recorder.lines]


def listen(
    backend: Any, sensor: SensorOnBus, clock: Clock, *, lock_name: str | None = None
) -> dict[str, Any]:
    """Return what the driver makes of a sensor: its identity, its controls, and the length of each frame or a fault."""
    heard: dict[str, Any] = {"product": sensor.discovered.product, "frames": []}
    try:
        opened = UvcSensor.open(backend, sensor, clock, lock_name=lock_name, controls=MINI_CONTROLS)
    except GelgateError as error:
        return {**heard, "fault": str(error)}
    identity = opened.identity
    heard |= {"serial": identity.serial, "mode": list(identity.mode), "nominal_fps": identity.nominal_fps}
    heard["unset_controls"] = opened.unset_controls
    try:
        for _ in range(FRAMES):
            heard["frames"].append(len(opened.read(clock.monotonic_ns() + _DEADLINE_NS).payload))
    except GelgateError as error:
        heard["fault"] = str(error)
    finally:
        opened.close()
    return heard


def _as_json(names: str) -> Callable[[Any], dict[str, Any]]:
    def describe(seen: Any) -> dict[str, Any]:
        fields = {name: getattr(seen, name) for name in names.split() if name != "extra_descriptors"}
        if "extra_descriptors" in names:
            fields["extra_descriptors"] = bytes(seen.extra_descriptors).hex()
        return fields

    return describe


def _shorten(packet: Packet) -> list[Any] | None:
    """[first bytes, how many were left out, last bytes]; None for a packet that was lost."""
    if not packet.arrived:
        return None
    data = packet.data
    header = data[0] if data else 0
    kept = header + _KEPT
    if data[header : header + 2] == b"\xff\xd8" and _START_OF_SCAN in data:
        kept = data.index(_START_OF_SCAN) + _KEPT
    last = max(kept, len(data) - _KEPT)
    return [data[:kept].hex(), last - kept if last < len(data) else 0, data[last:].hex()]
