"""A virtual camera served to the kernel's vhci-hcd over USB/IP.

Ref: Linux Documentation/usb/usbip_protocol.rst. Only the phase after the import is implemented: vhci gets the connected
socket directly. All numbers on the wire are big-endian.
"""

import errno
import socket
import struct
import threading
import time
from array import array
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import usb.core

from plugins.devices.uvc.payload import Packet
from plugins.devices.virtual import descriptors
from plugins.devices.virtual.camera import VirtualCamera
from plugins.devices.virtual.descriptors import STREAMING_INTERFACE, Board

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
CMD_SUBMIT, CMD_UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4
DEVICE_ID, HIGH_SPEED = 0x00010002, 3
MICROFRAME_S = 125e-6
# Emulation falls behind; a delay longer than this is not caught up.
LONGEST_LAG_S = 0.02
# Standard requests (USB 2.0 table 9-4) that are only acknowledged: set configuration, clear and set feature.
ACKNOWLEDGED = frozenset({(0x00, 9), (0x00, 1), (0x00, 3), (0x02, 1)})


@dataclass(frozen=True)
class IsoRequest:
    """A submitted isochronous transfer: its number, start frame and packet descriptors (offset, length)."""

    sequence: int
    start_frame: int
    packets: tuple[tuple[int, int], ...]


class UsbIpPort:
    """One port of the virtual host controller, with the camera on it or not."""

    def __init__(self, camera: VirtualCamera) -> None:
        self.camera = camera
        self._changed = threading.Condition()  # its lock is re-entrant
        self._writing = threading.Lock()
        self._waiting: list[IsoRequest] = []
        self._packets: list[Packet] = []
        self._is_attached = False

    def attach(self) -> None:
        """Plug the camera into the kernel."""
        self.camera.plug_in(address=self.camera.address + 1)
        with socket.create_server(("127.0.0.1", 0)) as listener:
            kernel_end = socket.create_connection(listener.getsockname())
            self._socket, _ = listener.accept()
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._waiting, self._packets, self._is_attached = [], [], True
        for work in (self._answer_requests, self._complete_transfers):
            threading.Thread(target=work, daemon=True).start()
        with kernel_end:
            (VHCI / "attach").write_text(f"0 {kernel_end.fileno()} {DEVICE_ID} {HIGH_SPEED}")

    def detach(self) -> None:
        """Unplug it."""
        self.camera.unplug()
        (VHCI / "detach").write_text("0")
        with self._changed:
            self._is_attached = False
            self._changed.notify_all()

    # What the kernel sends

    def _answer_requests(self) -> None:
        try:
            while True:
                self._answer(self._receive(48))
        except (EOFError, OSError):
            self._is_attached = False

    def _receive(self, count: int) -> bytes:
        received = b""
        while len(received) < count:
            part = self._socket.recv(count - len(received))
            if not part:
                raise EOFError
            received += part
        return received

    def _answer(self, header: bytes) -> None:
        command, sequence, _, direction, endpoint = struct.unpack_from(">5I", header)
        if command == CMD_UNLINK:
            self._unlink(sequence, struct.unpack_from(">I", header, 20)[0])
            return
        length, start_frame, packets = struct.unpack_from(">iii", header, 24)
        out = self._receive(length) if direction == 0 and length > 0 else b""
        if endpoint == 0:
            self._control(sequence, header[40:48], out, is_in=direction == 1)
        elif endpoint == descriptors.STREAMING_ENDPOINT & 0x0F:
            described = self._receive(16 * packets)
            asked = tuple(struct.unpack_from(">II", described, 16 * position) for position in range(packets))
            with self._changed:
                self._waiting.append(IsoRequest(sequence, start_frame, asked))
                self._changed.notify_all()
        # The status endpoint sends nothing: its transfers wait until they are unlinked.

    def _unlink(self, sequence: int, victim: int) -> None:
        with self._changed:
            before = len(self._waiting)
            self._waiting = [one for one in self._waiting if one.sequence != victim]
            status = -errno.ECONNRESET if len(self._waiting) < before else 0
            self._send(struct.pack(">5Ii24x", RET_UNLINK, sequence, 0, 0, 0, status))

    def _control(self, sequence: int, setup: bytes, out: bytes, *, is_in: bool) -> None:
        request_type, request, value, index, length = struct.unpack("<BBHHH", setup)
        try:
            answer = self._control_answer(
                request_type, request, value, index, out if not is_in else bytes(length)
            )
        except usb.core.USBError as error:
            self._reply(sequence, -(error.errno or errno.EPIPE), b"", 0)
            return
        answer = answer[:length]
        self._reply(sequence, 0, answer if is_in else b"", len(answer))

    def _control_answer(self, request_type: int, request: int, value: int, index: int, data: bytes) -> bytes:
        if (request_type, request) == (0x80, 6) and value >> 8 == 1:
            return device_bytes(descriptors.device_descriptor(bus=1, address=1, port=1))
        if (request_type, request) == (0x80, 6) and value >> 8 == 2:
            return configuration_bytes(self.camera.board)
        if (request_type, request) in ACKNOWLEDGED:
            return b""
        if (request_type, request) == (0x80, 0):  # get status: bus powered, no wake-up
            return b"\0\0"
        if (request_type, request) == (0x01, 11):  # set interface
            if index == STREAMING_INTERFACE:
                self.camera.select(value)
                self._packets = []
            return b""
        buffer = array("B", data)
        count = self.camera.control(request_type, request, value, index, buffer)
        return buffer.tobytes()[:count]

    # What the camera sends

    def _complete_transfers(self) -> None:
        """At the rate of a bus. A transfer is taken and answered in one step, so none is unlinked in between."""
        due = time.monotonic()
        while self._is_attached:
            with self._changed:
                if not self._changed.wait_for(lambda: self._waiting, 0.5):
                    continue
                packets = len(self._waiting[0].packets)
            due = max(due + packets * MICROFRAME_S, time.monotonic() - LONGEST_LAG_S)
            time.sleep(max(due - time.monotonic(), 0))
            with self._changed:
                if self._waiting:
                    self._complete(self._waiting.pop(0))

    def _complete(self, request: IsoRequest) -> None:
        """The data has no gaps; the descriptors give the place of each packet."""
        data = [self._next_packet(length) for _, length in request.packets]
        described = b"".join(
            struct.pack(">4I", offset, length, len(one), 0)
            for (offset, length), one in zip(request.packets, data, strict=True)
        )
        body = b"".join(data)
        head = (
            RET_SUBMIT,
            request.sequence,
            0,
            0,
            0,
            0,
            len(body),
            request.start_frame,
            len(request.packets),
            0,
        )
        self._send(struct.pack(">5Iiiiii8x", *head) + body + described)

    def _next_packet(self, room: int) -> bytes:
        if not self._packets and self.camera.is_present and self.camera.wait_ns() == 0:
            self._packets = self.camera.send(room)
        return self._packets.pop(0).data if self._packets else b""

    def _reply(self, sequence: int, status: int, data: bytes, actual: int) -> None:
        self._send(struct.pack(">5Iiiiii8x", RET_SUBMIT, sequence, 0, 0, 0, status, actual, 0, 0, 0) + data)

    def _send(self, message: bytes) -> None:
        """Errors: OSError when the kernel has closed the socket, which ends the sending thread."""
        with self._writing:
            self._socket.sendall(message)


def device_bytes(fields: SimpleNamespace) -> bytes:
    """The device descriptor on the bus (USB 2.0 table 9-8)."""
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        *(fields.bLength, fields.bDescriptorType, fields.bcdUSB),
        *(fields.bDeviceClass, fields.bDeviceSubClass, fields.bDeviceProtocol, fields.bMaxPacketSize0),
        *(fields.idVendor, fields.idProduct, fields.bcdDevice),
        *(fields.iManufacturer, fields.iProduct, fields.iSerialNumber, fields.bNumConfigurations),
    )


def configuration_bytes(board: Board) -> bytes:
    """The complete configuration: every interface with its class-specific descriptors and endpoints."""
    fields = descriptors.configuration_descriptor(board, 0)
    head = struct.pack(
        "<BBHBBBBB",
        *(fields.bLength, fields.bDescriptorType, fields.wTotalLength, fields.bNumInterfaces),
        *(fields.bConfigurationValue, fields.iConfiguration, fields.bmAttributes, fields.bMaxPower),
    )
    settings = [
        (0, 0),
        *((STREAMING_INTERFACE, alternate) for alternate in range(len(descriptors.ALTERNATE_PACKETS))),
    ]
    return (
        head + fields.extra_descriptors + b"".join(_interface_bytes(board, *setting) for setting in settings)
    )


def _interface_bytes(board: Board, number: int, alternate: int) -> bytes:
    fields = descriptors.interface_descriptor(board, number, alternate)
    head = bytes(
        (
            *(fields.bLength, fields.bDescriptorType, fields.bInterfaceNumber, fields.bAlternateSetting),
            *(fields.bNumEndpoints, fields.bInterfaceClass, fields.bInterfaceSubClass),
            *(fields.bInterfaceProtocol, fields.iInterface),
        )
    )
    endpoints = (
        descriptors.endpoint_descriptor(one, number, alternate) for one in range(fields.bNumEndpoints)
    )
    return head + fields.extra_descriptors + b"".join(_endpoint_bytes(one) for one in endpoints)


def _endpoint_bytes(fields: SimpleNamespace) -> bytes:
    return (
        struct.pack(
            "<BBBBHB",
            *(fields.bLength, fields.bDescriptorType, fields.bEndpointAddress, fields.bmAttributes),
            *(fields.wMaxPacketSize, fields.bInterval),
        )
        + fields.extra_descriptors
    )
