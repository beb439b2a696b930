"""A UVC sensor streamed through pyusb: claim the interfaces, negotiate a mode, read packets, return complete frames.

The same driver serves a real bus (`plugins.devices.uvc.libusb`) and a virtual one, without knowing which.

Ref: UVC 1.5 section 4.3.1.1 (negotiation); the kernel's behaviour as seen with uvcvideo on Linux 6.1
(firmware_notes/gelsight_mini.md).
"""

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from typing import Any, Protocol, Self

import usb.core
import usb.util

from edge.core.errors import DeviceError, DeviceLost, DeviceStalled, FrameCorrupt
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import Freshness, picture_size
from edge.core.ports import Clock, DeviceIdentity
from edge.core.sentence import Sentence
from plugins.devices.uvc.controls import pin_uvc_controls, report_unset
from plugins.devices.uvc.faults import guarded
from plugins.devices.uvc.identity import SensorOnBus, largest_mode, streaming_modes
from plugins.devices.uvc.lock import SensorLock
from plugins.devices.uvc.payload import FrameAssembler, Packet, ReceivedFrame
from plugins.devices.uvc.uvc import (
    BLOCK_SIZES,
    CLASS_VIDEO,
    COMMIT,
    GET_CUR,
    GET_LEN,
    PROBE,
    REQUEST_GET,
    REQUEST_SET,
    SET_CUR,
    SUBCLASS_CONTROL,
    StreamControl,
    VideoMode,
)

__all__ = ["PacketBackend", "PacketStream", "UvcSensor"]

# The longest single wait on the bus, so that a deadline and a `close` from outside take effect in time.
_LONGEST_WAIT_MS = 200


class PacketStream(Protocol):
    """Isochronous packets in the order of the bus, each with its own length."""

    def read(self, timeout_ms: int) -> list[Packet]:
        """The next packets. Errors: usb.core.USBTimeoutError, usb.core.USBError (errno 19 when unplugged)."""

    def close(self) -> None: ...


class PacketBackend(Protocol):
    """What a pyusb backend must add to `usb.backend.IBackend`: pyusb's own read loses the packet boundaries."""

    def packet_stream(self, dev_handle: Any, endpoint: int, packet_bytes: int) -> PacketStream: ...


class UvcSensor:
    """An open, streaming sensor (a `Device`).

    stale: frames that came twice and were not delivered. unset_controls: camera controls that could not be pinned, with
    the reasons. played_ns: set by a plugin whose frames come as fast as they are read; gives the time that the last one
    would have had in real time.
    """

    def __init__(
        self,
        identity: DeviceIdentity,
        stream: PacketStream,
        max_frame_bytes: int,
        clock: Clock,
        undo: ExitStack,
    ) -> None:
        self.identity = identity
        self.played_ns: Callable[[], int] | None = None
        self.unset_controls: dict[str, str] = {}
        self._stream = stream
        self._clock = clock
        self._undo = undo
        self._assembler = FrameAssembler(max_frame_bytes)
        self._received: deque[ReceivedFrame] = deque()
        self._freshness = Freshness()
        self._sequence = 0
        self._lost: str | None = None

    @classmethod
    def open(
        cls,
        backend: PacketBackend,
        found: SensorOnBus,
        clock: Clock,
        *,
        lock_name: str | None = None,
        controls: Mapping[str, int] | None = None,
    ) -> Self:
        """Lock, claim, set and start the sensor; every step is undone when a later one fails.

        Errors: DeviceBusy, DeviceLost, DeviceStalled.
        """
        identity = found.discovered.identity
        if identity is None:
            raise ValueError(f"{found.discovered.place} is not a sensor: {found.discovered.refusal}")
        undo = ExitStack()
        try:
            undo.callback(SensorLock(lock_name or identity.serial).close)
            with guarded(f"{identity.product} at {found.discovered.place}"):
                _quietly(undo, usb.util.dispose_resources, found.device)
                _take_interfaces(found.device, undo)
                unset = pin_uvc_controls(found.device, controls or {})
                stream, limit = _start_stream(backend, found.device, undo)
        except BaseException:
            undo.close()
            raise
        report_unset(identity.serial, unset)
        sensor = cls(identity, stream, limit, clock, undo)
        sensor.unset_controls = unset
        return sensor

    @property
    def on_demand(self) -> bool:
        return self.played_ns is not None

    @property
    def stale(self) -> int:
        return self._freshness.stale

    def read(self, deadline_ns: int) -> CameraFrame:
        if self._lost is not None:
            raise DeviceLost(self._lost)
        while True:
            frame = self._next_received(deadline_ns)
            self._check(frame)
            if self._freshness.is_new(frame.payload):
                time_ns = self.played_ns() if self.played_ns else self._clock.monotonic_ns()
                self._sequence += 1
                return CameraFrame(frame.payload, time_ns, self._sequence - 1, self.on_demand)

    def _next_received(self, deadline_ns: int) -> ReceivedFrame:
        while not self._received:
            remaining_ms = -((self._clock.monotonic_ns() - deadline_ns) // 1_000_000)  # rounded up
            if remaining_ms <= 0:
                raise DeviceStalled(
                    Sentence(
                        f"{self.identity.product} gave no new frame in time ({self.stale} repeated frames until now)"
                    )
                )
            self._received.extend(
                self._assembler.feed(self._read_packets(min(remaining_ms, _LONGEST_WAIT_MS)))
            )
        return self._received.popleft()

    def _read_packets(self, timeout_ms: int) -> list[Packet]:
        try:
            with guarded(self.identity.product):
                return self._stream.read(timeout_ms)
        except DeviceStalled:
            return []
        except DeviceLost as error:
            self._lost = str(error)
            raise

    def _check(self, frame: ReceivedFrame) -> None:
        fault = frame.fault
        if fault is None and (size := picture_size(frame.payload)) not in (None, self.identity.mode):
            fault = f"a picture of {size}; the video mode is {self.identity.mode}"
        if fault is not None:
            self._sequence += 1
            raise FrameCorrupt(f"{self.identity.product}, frame {self._sequence - 1}: {fault}")

    def close(self) -> None:
        """Stop the stream, return the interfaces to the kernel and release the lock."""
        self._lost = self._lost or f"{self.identity.product} was closed"
        self._undo.close()


def _quietly(undo: ExitStack, step: Any, *arguments: object) -> None:
    """Undo a step at closing, where a missing sensor is not an error."""

    def attempt() -> None:
        with suppress(usb.core.USBError, DeviceError):
            step(*arguments)

    undo.callback(attempt)


def _take_interfaces(device: Any, undo: ExitStack) -> None:
    """Detach uvcvideo from both interfaces and claim them.

    The kernel releases the streaming interface together with the control interface, and binds both again when the
    control interface is attached. So the state of each is read immediately before it is changed.
    """
    numbers = [_control_interface(device), streaming_modes(device)[0]]
    for number in numbers:
        if device.is_kernel_driver_active(number):
            device.detach_kernel_driver(number)
            _quietly(undo, device.attach_kernel_driver, number)
    for number in numbers:
        usb.util.claim_interface(device, number)
        _quietly(undo, usb.util.release_interface, device, number)


def _control_interface(device: Any) -> int:
    for interface in device.get_active_configuration():
        if (interface.bInterfaceClass, interface.bInterfaceSubClass) == (CLASS_VIDEO, SUBCLASS_CONTROL):
            return int(interface.bInterfaceNumber)
    raise DeviceLost(f"{device.product} has no video control interface")


def _start_stream(backend: PacketBackend, device: Any, undo: ExitStack) -> tuple[PacketStream, int]:
    """(the running stream, the longest frame the camera promises)."""
    number, modes = streaming_modes(device)
    mode = largest_mode(modes)
    agreed = _negotiate(device, number, mode)
    alternate, endpoint, packet_bytes = _alternate_for(device, number, agreed.max_payload_bytes)
    device.set_interface_altsetting(number, alternate)
    _quietly(undo, device.set_interface_altsetting, number, 0)
    stream = backend.packet_stream(device._ctx.handle, endpoint, packet_bytes)
    _quietly(undo, stream.close)
    return stream, agreed.max_frame_bytes or mode.max_frame_bytes


def _negotiate(device: Any, number: int, mode: VideoMode) -> StreamControl:
    """Set probe, read the camera's answer, commit exactly that."""
    size = _block_size(device, number)
    wish = StreamControl(mode.format_index, mode.frame_index, mode.intervals[0])
    device.ctrl_transfer(REQUEST_SET, SET_CUR, PROBE << 8, number, wish.pack(size))
    answer = StreamControl.unpack(bytes(device.ctrl_transfer(REQUEST_GET, GET_CUR, PROBE << 8, number, size)))
    device.ctrl_transfer(REQUEST_SET, SET_CUR, COMMIT << 8, number, answer.pack(size))
    return answer


def _block_size(device: Any, number: int) -> int:
    """The camera's answer; 26 bytes (UVC 1.0) without one, because many cameras stall this request."""
    try:
        length = int.from_bytes(
            bytes(device.ctrl_transfer(REQUEST_GET, GET_LEN, PROBE << 8, number, 2)), "little"
        )
    except usb.core.USBError:
        return BLOCK_SIZES[0]
    return max(length, BLOCK_SIZES[0])


def _alternate_for(device: Any, number: int, payload_bytes: int) -> tuple[int, int, int]:
    """(alternate setting, endpoint address, bytes per micro-frame): the smallest that carries the agreed payload."""
    settings = []
    for interface in device.get_active_configuration():
        if interface.bInterfaceNumber == number and interface.bAlternateSetting != 0:
            for endpoint in interface:
                # Up to three transactions: bits 0-10 the size, bits 11-12 how many more (USB 2.0, table 9-13).
                packet = int(endpoint.wMaxPacketSize)
                room = (packet & 0x7FF) * ((packet >> 11 & 3) + 1)
                settings.append((room, int(interface.bAlternateSetting), int(endpoint.bEndpointAddress)))
    for room, alternate, address in sorted(settings):
        if room >= payload_bytes:
            return alternate, address, room
    raise DeviceLost(
        f"{device.product} asks for {payload_bytes} bytes per micro-frame; no alternate setting has as many"
    )
