"""The real backend on a substitute for libusb: packet lengths, losses, the queue, and the release of everything.

The private parts of pyusb are checked by using them.
"""

import ctypes
import errno
import gc
import weakref
from typing import Any

import pytest
import usb.backend.libusb1 as libusb1
import usb.core

from plugins.devices.uvc.libusb import PACKETS_PER_TRANSFER, TRANSFERS, LibusbPacketStream, get_backend
from plugins.devices.uvc.payload import FrameAssembler, split_frame

PACKET_BYTES = 64


class FakeLibusb:
    """Transfers complete in the order of their submission, one per round of events, filled from `packets`. A packet is
    (bytes, status). When none is left, events bring nothing."""

    def __init__(self, packets: list[tuple[bytes, int]]) -> None:
        self.packets = packets
        self.flying: list[Any] = []
        self.freed = 0
        self.status = libusb1.LIBUSB_TRANSFER_COMPLETED
        self._memory: list[Any] = []
        self._setup_inline()

    def _setup_inline(self) -> None:
        """The two functions that are inline in libusb.h come from pyusb itself, as with the real library."""
        real = libusb1._lib or (get_backend() and libusb1._lib)
        self.libusb_fill_iso_transfer = real.libusb_fill_iso_transfer
        self.libusb_set_iso_packet_lengths = real.libusb_set_iso_packet_lengths

    def libusb_alloc_transfer(self, count: int) -> Any:
        size = ctypes.sizeof(libusb1._libusb_transfer) + count * ctypes.sizeof(
            libusb1._libusb_iso_packet_descriptor
        )
        self._memory.append(ctypes.create_string_buffer(size))
        return ctypes.cast(self._memory[-1], ctypes.POINTER(libusb1._libusb_transfer))

    def libusb_submit_transfer(self, transfer: Any) -> int:
        self.flying.append(transfer)
        return 0

    def libusb_cancel_transfer(self, transfer: Any) -> int:
        self.status = libusb1.LIBUSB_TRANSFER_CANCELLED
        return 0

    def libusb_handle_events_timeout_completed(self, context: Any, wait: Any, completed: Any) -> int:
        cancelled = self.status == libusb1.LIBUSB_TRANSFER_CANCELLED
        if self.flying and (self.packets or cancelled or self.status != libusb1.LIBUSB_TRANSFER_COMPLETED):
            transfer = self.flying.pop(0)
            self._fill(transfer.contents)
            transfer.contents.status = self.status
            transfer.contents.callback(transfer)
        return 0

    def _fill(self, transfer: Any) -> None:
        for position, descriptor in enumerate(libusb1._get_iso_packet_list(transfer)):
            data, status = self.packets.pop(0) if self.packets else (b"", 0)
            assert descriptor.length == PACKET_BYTES
            descriptor.actual_length, descriptor.status = len(data), status
            ctypes.memmove(transfer.buffer + position * PACKET_BYTES, data, len(data))

    def libusb_free_transfer(self, transfer: Any) -> None:
        self.freed += 1


def stream_of(lib: FakeLibusb) -> LibusbPacketStream:
    return LibusbPacketStream(lib, None, ctypes.c_void_p(1), 0x81, PACKET_BYTES)


def test_frames_come_back_through_the_queue() -> None:
    """Three frames over hundreds of short packets with strides between them are read completely, which pyusb itself
    cannot do."""
    film = [b"\xff\xd8" + bytes([65 + number]) * 9000 + b"\xff\xd9" for number in range(3)]
    packets = [
        (packet.data, 0)
        for number, frame in enumerate(film)
        for packet in split_frame(frame, fid=number & 1, pts=0, packet_bytes=PACKET_BYTES)
    ]
    lib = FakeLibusb(packets)
    stream = stream_of(lib)
    assembler = FrameAssembler()
    frames = []
    while len(frames) < 3:
        frames += assembler.feed(stream.read(100))
    assert [frame.payload for frame in frames] == film
    assert [frame.fault for frame in frames] == [None, None, None]
    stream.close()


def test_what_the_bus_sent_while_no_transfer_was_in_flight_is_a_loss() -> None:
    """After a pause every transfer has come back, and the packets of that time went nowhere: the beginning of one frame
    and the end of a later one of the same parity are no whole picture."""
    before, later = (
        [
            (packet.data, 0)
            for packet in split_frame(
                b"\xff\xd8\xff" + byte * 80_000 + b"\xff\xd9", fid=0, pts=0, packet_bytes=64
            )
        ]
        for byte in (b"A", b"B")
    )
    lib = FakeLibusb(before[: TRANSFERS * PACKETS_PER_TRANSFER] + later[-300:])
    stream = stream_of(lib)
    for _ in range(TRANSFERS):
        lib.libusb_handle_events_timeout_completed(None, None, None)
    assembler = FrameAssembler()
    frames = [frame for _ in range(TRANSFERS + 5) for frame in assembler.feed(stream.read(100))]
    stream.close()

    assert [frame.fault for frame in frames] == ["a packet was lost on the bus"]
    assert b"AB" in frames[0].payload


def test_a_packet_status_is_kept() -> None:
    """A packet that the controller flags is not taken for one that arrived."""
    stream = stream_of(FakeLibusb([(b"ab", 0), (b"cd", libusb1.LIBUSB_TRANSFER_ERROR)]))
    first, second, *rest = stream.read(100)
    assert (first.data, first.arrived, second.arrived) == (b"ab", True, False)
    assert len(rest) == PACKETS_PER_TRANSFER - 2
    stream.close()


def test_all_transfers_are_in_flight() -> None:
    """The queue is full from the start, and each completed transfer is sent out again."""
    lib = FakeLibusb([(b"ab", 0)])
    stream = stream_of(lib)
    assert len(lib.flying) == TRANSFERS
    stream.read(100)
    assert len(lib.flying) == TRANSFERS
    stream.close()


def test_silence_is_a_timeout() -> None:
    """Nothing completed: the timeout error that the driver takes for waiting."""
    stream = stream_of(FakeLibusb([]))
    with pytest.raises(usb.core.USBTimeoutError):
        stream.read(1)
    stream.close()


def test_unplugged_is_no_device() -> None:
    """A transfer that ends with NO_DEVICE is errno 19."""
    lib = FakeLibusb([])
    stream = stream_of(lib)
    lib.status = libusb1.LIBUSB_TRANSFER_NO_DEVICE
    with pytest.raises(usb.core.USBError) as lost:
        stream.read(1)
    assert lost.value.errno == errno.ENODEV


def test_close_cancels_waits_and_frees() -> None:
    """Every transfer is back before it is freed, once, however often one closes."""
    lib = FakeLibusb([])
    stream = stream_of(lib)
    stream.close()
    stream.close()
    assert (lib.flying, lib.freed) == ([], TRANSFERS)


def test_a_wait_that_is_interrupted_ends_no_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a signal: transfers that are in flight would be left in the hands of libusb, with buffers that are gone."""
    lib = FakeLibusb([])
    stream, handle = stream_of(lib), lib.libusb_handle_events_timeout_completed
    outcomes = [libusb1.LIBUSB_ERROR_INTERRUPTED, libusb1.LIBUSB_ERROR_NO_DEVICE]
    monkeypatch.setattr(
        lib,
        "libusb_handle_events_timeout_completed",
        lambda *given: outcomes.pop() if outcomes else handle(*given),
    )
    stream.close()
    assert (lib.flying, lib.freed) == ([], TRANSFERS)


def test_what_libusb_never_gives_back_keeps_its_memory() -> None:
    """It may still write into the buffers, and call what was to be called."""

    class Stuck(FakeLibusb):
        def libusb_handle_events_timeout_completed(self, *given: Any) -> int:
            return 0

    lib = Stuck([])
    stream = stream_of(lib)
    stream.close()
    assert lib.freed == 0
    is_there = weakref.ref(stream)
    del stream, lib
    gc.collect()
    assert is_there() is not None


def test_there_is_one_backend_for_all() -> None:
    """A backend that is collected shuts libusb down under the devices found through it: a crash after an unplug."""
    assert get_backend() is get_backend()


def test_the_real_library_loads_and_looks() -> None:
    """libusb comes with its wheel, and a machine without a sensor has none."""
    assert list(get_backend().enumerate_devices()) is not None
