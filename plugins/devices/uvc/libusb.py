"""The real bus: pyusb's libusb1 backend, plus isochronous reads that keep every packet's length.

Ref: pyusb 1.3.1, usb/backend/libusb1.py, whose private structures are used here (the version is pinned and a test
checks the names); libusb 1.0 API, "asynchronous device I/O". Many transfers are queued, because one at a time loses the
micro-frames between two calls.

Seen: a virtual camera over USB/IP under a real kernel (Linux 6.1, vhci-hcd, usbfs): complete frames, controls set,
interfaces released, unplugged and plugged in again (tests/hardware/kernel_lab). Not yet seen: a sensor on a physical
bus.
"""

import ctypes
import errno
from collections import deque
from contextlib import suppress
from functools import cache
from typing import Any

import usb.backend.libusb1 as libusb1
import usb.core

from edge.core.errors import DeviceNotFound
from plugins.devices.uvc.payload import Packet

__all__ = ["LibusbBackend", "LibusbPacketStream", "get_backend"]

# 16 transfers of 64 micro-frames are 128 ms: longer than any pause of the interpreter seen in practice, and 3 MB,
# well under the 16 MB that usbfs grants (usbcore.usbfs_memory_mb).
TRANSFERS, PACKETS_PER_TRANSFER = 16, 64


# Streams of which libusb has kept a transfer: they stay in memory.
_never_back: list["LibusbPacketStream"] = []


class _TimeVal(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_usec", ctypes.c_long))


class LibusbBackend(libusb1._LibUSB):  # type: ignore[misc]  # pyusb is untyped
    """pyusb's backend with `packet_stream`."""

    def packet_stream(self, dev_handle: Any, endpoint: int, packet_bytes: int) -> "LibusbPacketStream":
        return LibusbPacketStream(self.lib, self.ctx, dev_handle.handle, endpoint, packet_bytes)


class LibusbPacketStream:
    """A queue of isochronous transfers in flight. `lib` is the loaded libusb, `handle` an open device."""

    def __init__(self, lib: Any, context: Any, handle: Any, endpoint: int, packet_bytes: int) -> None:
        self._lib, self._context, self._packet_bytes = lib, context, packet_bytes
        self._completed: deque[int] = deque()
        self._flying: set[int] = set()
        # Transfers with which the queue ran dry: of what came after them no packet is known, nor how many there were.
        self._dry: set[int] = set()
        self._closing = False
        self._callback = libusb1._libusb_transfer_cb_fn_p(self._on_complete)
        self._buffers = [
            ctypes.create_string_buffer(packet_bytes * PACKETS_PER_TRANSFER) for _ in range(TRANSFERS)
        ]
        self._transfers = [self._prepared(handle, endpoint, buffer) for buffer in self._buffers]
        self._position = {
            ctypes.addressof(transfer.contents): i for i, transfer in enumerate(self._transfers)
        }
        try:
            for position in range(TRANSFERS):
                self._submit(position)
        except usb.core.USBError:
            self.close()
            raise

    def _prepared(self, handle: Any, endpoint: int, buffer: Any) -> Any:
        transfer = self._lib.libusb_alloc_transfer(PACKETS_PER_TRANSFER)
        self._lib.libusb_fill_iso_transfer(
            transfer, handle, endpoint, buffer, len(buffer), PACKETS_PER_TRANSFER, self._callback, None, 0
        )
        self._lib.libusb_set_iso_packet_lengths(transfer, self._packet_bytes)
        return transfer

    def _submit(self, position: int) -> None:
        libusb1._check(self._lib.libusb_submit_transfer(self._transfers[position]))
        self._flying.add(position)

    def _on_complete(self, transfer: Any) -> None:
        position = self._position[ctypes.addressof(transfer.contents)]
        self._flying.discard(position)
        self._completed.append(position)
        if not self._flying:
            self._dry.add(position)

    def read(self, timeout_ms: int) -> list[Packet]:
        """The packets of the next completed transfer; a lost one behind them where the bus went on without us."""
        if not self._completed:
            self._handle_events(timeout_ms)
        if not self._completed:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        position = self._completed.popleft()
        status = int(self._transfers[position].contents.status)
        if status != libusb1.LIBUSB_TRANSFER_COMPLETED:
            raise usb.core.USBError(
                libusb1._str_transfer_error[status], status, libusb1._transfer_errno[status]
            )
        packets = self._packets(position)
        if position in self._dry:
            self._dry.discard(position)
            packets.append(Packet(b"", arrived=False))
        self._submit(position)
        return packets

    def _packets(self, position: int) -> list[Packet]:
        """Packet n starts at n strides in the buffer, and only its first bytes are valid."""
        descriptors = libusb1._get_iso_packet_list(self._transfers[position].contents)
        view = memoryview(self._buffers[position])
        return [
            Packet(
                bytes(view[start : start + packet.actual_length]),
                packet.status == libusb1.LIBUSB_TRANSFER_COMPLETED,
            )
            for start, packet in zip(range(0, len(view), self._packet_bytes), descriptors, strict=True)
        ]

    def _handle_events(self, timeout_ms: int) -> None:
        wait = _TimeVal(timeout_ms // 1000, timeout_ms % 1000 * 1000)
        libusb1._check(
            self._lib.libusb_handle_events_timeout_completed(self._context, ctypes.byref(wait), None)
        )

    def close(self) -> None:
        """Cancel what is in flight, wait for the cancellations, free the rest; harmless when repeated."""
        if self._closing:
            return
        self._closing = True
        for position in self._flying:
            self._lib.libusb_cancel_transfer(self._transfers[position])
        for _ in range(TRANSFERS * 4):
            if not self._flying:
                break
            with suppress(usb.core.USBError):  # a signal has interrupted it, or the sensor is gone
                self._handle_events(100)
        # libusb still uses a transfer that did not come back, with its buffer and callback: freeing it would crash.
        if self._flying:
            _never_back.append(self)
        for position, transfer in enumerate(self._transfers):
            if position not in self._flying:
                self._lib.libusb_free_transfer(transfer)


@cache
def get_backend() -> LibusbBackend:
    """The libusb of the system or of the `libusb-package` wheel. Errors: DeviceNotFound when neither loads.

    One per process: a second one shuts its libusb down when it is collected, perhaps before the devices found through
    it, and libusb then reads freed memory (seen: a crash after an unplug).
    """
    import libusb_package

    if libusb_package.get_libusb1_backend() is None or libusb1._lib is None:
        raise DeviceNotFound("libusb-1.0 cannot be loaded; install the Debian package libusb-1.0-0")
    lib = libusb1._lib
    lib.libusb_cancel_transfer.argtypes = [ctypes.POINTER(libusb1._libusb_transfer)]
    lib.libusb_handle_events_timeout_completed.argtypes = [
        ctypes.c_void_p,
        ctypes.POINTER(_TimeVal),
        ctypes.POINTER(ctypes.c_int),
    ]
    return LibusbBackend(lib)
