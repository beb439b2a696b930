"""One virtual UVC camera: its state, the answers on its control pipe, and the packets that it sends.

It plays frames from any sequence of JPEG bytes. Time is the injected clock's.
"""

import errno
import math
from collections.abc import Sequence
from threading import RLock
from typing import Any

import usb.core

from edge.core.errors import RecordingEnded
from edge.core.ports import Clock
from plugins.devices.uvc.payload import Packet, split_frame
from plugins.devices.uvc.uvc import (
    COMMIT,
    GET_CUR,
    GET_DEF,
    GET_LEN,
    GET_MAX,
    GET_MIN,
    PROBE,
    SET_CUR,
    UNITS_PER_SECOND,
    StreamControl,
)
from plugins.devices.virtual.controls import ControlBank
from plugins.devices.virtual.descriptors import (
    ALTERNATE_PACKETS,
    CONTROL_INTERFACE,
    STREAMING_INTERFACE,
    Board,
    string_descriptor,
)
from plugins.devices.virtual.faults import Fault, FaultKind

__all__ = ["VirtualCamera", "VirtualPacketStream", "usb_error"]

# Up to three transactions of 1024 bytes per micro-frame.
MAX_PAYLOAD_BYTES = 3072
PACKETS_PER_READ = 32
# A camera played as fast as it is read has its own time; that it was opened again is an interruption there, too.
_OPENING_NS = 1_000_000_000
PROBE_BYTES = 26

_STANDARD_GET_DESCRIPTOR = (0x80, 0x06)
_NO_CONTROL = StreamControl(1, 1, 0)


def usb_error(number: int) -> usb.core.USBError:
    """The error of libusb's backend for an errno, with the same code and text."""
    code, text = {
        errno.ENODEV: (-4, "No such device (it may have been disconnected)"),
        errno.ENOENT: (-5, "Entity not found"),
        errno.EBUSY: (-6, "Resource busy"),
        errno.ETIMEDOUT: (-7, "Operation timed out"),
        errno.EPIPE: (-9, "Pipe error"),
    }[number]
    kind = usb.core.USBTimeoutError if number == errno.ETIMEDOUT else usb.core.USBError
    return kind(text, code, number)


class VirtualCamera:
    """A camera on the virtual bus. gaps_ns: from the frame before to each frame; without them frames come at the rate
    of the video mode. pace: 1 is real time, 2 twice as fast, 0 as fast as it is read."""

    def __init__(
        self,
        board: Board,
        frames: Sequence[bytes],
        clock: Clock,
        *,
        gaps_ns: Sequence[int] = (),
        pace: float = 1.0,
        loop: bool = False,
        faults: Sequence[Fault] = (),
        port: int = 1,
    ) -> None:
        self.board = board
        self.port = port
        self.address = 0
        self.frames_sent = 0
        self._frames, self._clock, self._pace, self._loop = frames, clock, pace, loop
        self._gaps_ns = gaps_ns
        self._script = {fault.frame: fault for fault in faults}
        self._guard = RLock()
        self._position = 0
        self._number = 0
        self._last = b""
        self._fid = 0
        self._due_ns: int | None = None
        self._played_ns = 0
        self._return_ns: int | None = None
        self.is_present = False
        self._forget_host()

    def _forget_host(self) -> None:
        """The initial state: uvcvideo bound to both interfaces, nothing claimed, negotiated or set."""
        self.claims: dict[int, object] = {}
        self.kernel_driver = {CONTROL_INTERFACE: True, STREAMING_INTERFACE: True}
        self.alternate = 0
        self.controls = ControlBank()
        self._probe = self._committed = _NO_CONTROL
        self._silent_until_ns: float | None = None

    # Plugging

    def plug_in(self, *, address: int, port: int | None = None) -> None:
        """Connect at a new address."""
        with self._guard:
            self.address = address
            self.port = self.port if port is None else port
            self._forget_host()
            self._return_ns = None
            self.is_present = True

    def unplug(self, seconds: float = 0.0) -> None:
        """Disconnect, for this many seconds or (0) until it is plugged in again."""
        with self._guard:
            self.is_present = False
            self._return_ns = self._clock.monotonic_ns() + round(seconds * 1e9) if seconds else None

    @property
    def wants_back(self) -> bool:
        """True when the time of an unplugging is over."""
        return self._return_ns is not None and self._clock.monotonic_ns() >= self._return_ns

    # Control pipe

    def control(self, request_type: int, request: int, value: int, index: int, data: Any) -> int:
        """Answer one control transfer; `data` is filled for IN requests. Returns the byte count. Errors: USBError."""
        if (request_type, request) == _STANDARD_GET_DESCRIPTOR and value >> 8 == 3:
            return self._string(value & 0xFF, data)
        if index & 0xFF == STREAMING_INTERFACE and request_type & 0x7F == 0x21:
            return self._streaming_request(request, value >> 8, data)
        if index & 0xFF == CONTROL_INTERFACE and request_type & 0x7F == 0x21:
            return self._control_request(request, index >> 8, value >> 8, data)
        raise usb_error(errno.EPIPE)

    def _string(self, index: int, data: Any) -> int:
        try:
            return _fill(data, string_descriptor(self.board, index))
        except IndexError as error:
            raise usb_error(errno.EPIPE) from error

    def _control_request(self, request: int, entity: int, selector: int, data: Any) -> int:
        answer = self.controls.request(request, entity, selector, data)
        if answer is None:
            raise usb_error(errno.EPIPE)
        return _fill(data, answer) if request != SET_CUR else len(data)

    def _streaming_request(self, request: int, selector: int, data: Any) -> int:
        if request == SET_CUR and selector == PROBE:
            self._probe = self._answer(StreamControl.unpack(bytes(data)))
            return len(data)
        if request == SET_CUR and selector == COMMIT:
            self._committed = self._answer(StreamControl.unpack(bytes(data)))
            return len(data)
        if request == GET_LEN:
            return _fill(data, PROBE_BYTES.to_bytes(2, "little"))
        if request in (GET_CUR, GET_MIN, GET_MAX, GET_DEF) and selector in (PROBE, COMMIT):
            current = self._committed if selector == COMMIT else self._probe
            block = current if request == GET_CUR else self._answer(StreamControl(1, 1, 0))
            return _fill(data, block.pack(PROBE_BYTES))
        raise usb_error(errno.EPIPE)

    def _answer(self, wish: StreamControl) -> StreamControl:
        """The camera's answer to a request: an unknown format or mode is a stall, the interval is the camera's."""
        if wish.format_index != 1 or not 1 <= wish.frame_index <= len(self.board.modes):
            raise usb_error(errno.EPIPE)
        width, height, fps = self.board.modes[wish.frame_index - 1]
        return StreamControl(
            1,
            wish.frame_index,
            round(UNITS_PER_SECOND / fps),
            wish.hint,
            Board.max_frame_bytes(width, height),
            MAX_PAYLOAD_BYTES,
        )

    # Streaming

    def select(self, alternate: int) -> None:
        """Alternate setting of the streaming interface: 0 stops, another starts, which also ends a stall."""
        if not 0 <= alternate < len(ALTERNATE_PACKETS):
            raise usb_error(errno.ENOENT)
        with self._guard:
            self.alternate = alternate
            self._due_ns = None
            self._played_ns = max(self._played_ns + _OPENING_NS, self._clock.monotonic_ns())
            if self._silent_until_ns == math.inf:
                self._silent_until_ns = None

    def wait_ns(self) -> int | None:
        """Nanoseconds until the next frame is due; None when none is coming (stalled, or not streaming)."""
        if self.alternate == 0 or self._committed == _NO_CONTROL or self._silent_until_ns == math.inf:
            return None
        now = self._clock.monotonic_ns()
        if self._silent_until_ns is not None:
            return max(round(self._silent_until_ns) - now, 0)
        if self._pace == 0:
            return 0
        if self._due_ns is None:
            self._due_ns = now + self._gap_ns()
        return max(self._due_ns - now, 0)

    def _gap_ns(self) -> int:
        """The time from the frame sent last to the next one."""
        if self._gaps_ns:
            gap_ns: float = self._gaps_ns[self._position % len(self._gaps_ns)]
        else:
            gap_ns = 1e9 / self.board.modes[self._committed.frame_index - 1][2]
        return round(gap_ns / (self._pace or 1.0))

    def played_ns(self) -> int:
        """When the frame sent last would have been sent in real time: at pace 0 frames come sooner than that."""
        return self._played_ns

    def send(self, packet_bytes: int) -> list[Packet]:
        """The packets of the frame that is due: none when it is dropped. Errors: RecordingEnded, USBError."""
        with self._guard:
            self._silent_until_ns = None
            if self._position >= len(self._frames):
                if not self._loop or not len(self._frames):
                    raise RecordingEnded(
                        f"{self.board.product}: the recording of {len(self._frames)} frames is over"
                    )
                self._position = 0
            fault = self._script.pop(self._number, None)
            if fault is not None and fault.kind in ("stall", "unplug"):
                return self._go_away(fault)
            payload = self._frames[self._position]
            self._played_ns += self._gap_ns()
            self._position += 1
            self._number += 1
            self._advance_due()
            return self._packets(payload, fault.kind if fault else None, packet_bytes)

    def _go_away(self, fault: Fault) -> list[Packet]:
        """The frame itself is not lost: it is sent when the camera is back."""
        self._played_ns += round(fault.seconds * 1e9)
        if fault.kind == "unplug":
            self.unplug(fault.seconds)
            raise usb_error(errno.ENODEV)
        self._silent_until_ns = (
            self._clock.monotonic_ns() + fault.seconds * 1e9 if fault.seconds else math.inf
        )
        return []

    def _advance_due(self) -> None:
        """Keep the frame rate; when the host is more than one period late, the period starts again."""
        if self._due_ns is not None and self._pace:
            now = self._clock.monotonic_ns()
            self._due_ns += self._gap_ns()
            if self._due_ns < now:
                self._due_ns = now

    def _packets(self, payload: bytes, fault: FaultKind | None, packet_bytes: int) -> list[Packet]:
        if fault == "drop":
            return []
        if fault == "stale":
            payload = self._last or payload
        self._last = payload
        if fault == "truncate":
            payload = payload[: len(payload) // 2]
        error_in = frozenset({0} if fault == "error_bit" else ())
        self._fid ^= 1
        pts = self._clock.monotonic_ns() // 1000
        packets = list(
            split_frame(payload, fid=self._fid, pts=pts, packet_bytes=packet_bytes, error_in=error_in)
        )
        if fault == "lost_packet":
            packets[len(packets) // 2] = Packet(b"", arrived=False)
        self.frames_sent += 1
        return packets


class VirtualPacketStream:
    """The isochronous endpoint of a camera, as `plugins.devices.uvc.stream.PacketStream`."""

    def __init__(self, camera: VirtualCamera, clock: Clock, packet_bytes: int) -> None:
        self._camera, self._clock, self._packet_bytes = camera, clock, packet_bytes
        self._address = camera.address
        self._waiting: list[Packet] = []

    def read(self, timeout_ms: int) -> list[Packet]:
        if not self._waiting:
            self._require_camera()
            self._await_frame(timeout_ms * 1_000_000)
            self._require_camera()
            self._waiting = self._camera.send(self._packet_bytes)
        batch, self._waiting = self._waiting[:PACKETS_PER_READ], self._waiting[PACKETS_PER_READ:]
        return batch

    def _await_frame(self, timeout_ns: int) -> None:
        wait_ns = self._camera.wait_ns()
        if wait_ns is None or wait_ns > timeout_ns:
            self._clock.sleep(timeout_ns / 1e9)
            self._require_camera()
            raise usb_error(errno.ETIMEDOUT)
        if wait_ns:
            self._clock.sleep(wait_ns / 1e9)

    def _require_camera(self) -> None:
        if not self._camera.is_present or self._camera.address != self._address:
            raise usb_error(errno.ENODEV)

    def close(self) -> None:
        self._waiting = []


def _fill(data: Any, content: bytes) -> int:
    """Copy as much of `content` as fits into pyusb's buffer."""
    count = min(len(data), len(content))
    for position in range(count):
        data[position] = content[position]
    return count
