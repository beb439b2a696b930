"""UVC payloads: cutting a frame into isochronous packets, and putting packets together to frames again.

Ref: UVC 1.5 section 2.4.3.3 (payload header). Both halves are pure and in one module, so each can test the other. A UVC
packet has no sequence number: a loss that the host controller does not report cannot be detected, so every packet here
carries its transfer status.
"""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from edge.core.imaging.image_bytes import damage

__all__ = ["FrameAssembler", "Packet", "ReceivedFrame", "split_frame"]

FID, EOF, PTS, SCR, STILL, ERROR, END_OF_HEADER = 0x01, 0x02, 0x04, 0x08, 0x20, 0x40, 0x80
_PLAIN_HEADER, _PTS_HEADER = 2, 6


class Packet(NamedTuple):
    """One isochronous packet as the host controller gave it: its own bytes, and whether it arrived complete."""

    data: bytes
    arrived: bool = True


@dataclass(frozen=True)
class ReceivedFrame:
    """One frame from the wire. `fault` says why it cannot be trusted; `pts` is the camera's clock, when sent."""

    payload: bytes
    pts: int | None = None
    fault: str | None = None


def split_frame(
    payload: bytes, *, fid: int, pts: int, packet_bytes: int, error_in: frozenset[int] = frozenset()
) -> Iterator[Packet]:
    """A frame as packets of at most `packet_bytes`, each with a 6-byte header, EOF on the last.

    fid: 0 or 1, toggled by the caller from frame to frame. error_in: positions whose error bit is set.
    """
    room = packet_bytes - _PTS_HEADER
    if room < 1 or fid not in (0, 1):
        raise ValueError(
            f"packets hold more than {_PTS_HEADER} bytes and fid is 0 or 1, found {packet_bytes} and {fid}"
        )

    def header(flags: int) -> bytes:
        return struct.pack("<BBI", _PTS_HEADER, END_OF_HEADER | PTS | fid | flags, pts & 0xFFFFFFFF)

    starts = range(0, max(len(payload), 1), room)
    plain = header(0)
    for position, start in enumerate(starts):
        flags = EOF * (position == len(starts) - 1) | ERROR * (position in error_in)
        yield Packet((header(flags) if flags else plain) + payload[start : start + room])


class FrameAssembler:
    """Puts packets together to frames. A frame is returned complete, or with its fault; never silently short.

    max_frame_bytes: the camera's limit (dwMaxVideoFrameSize); 0 when it states none. What arrives before the first
    frame boundary belongs to a frame whose start was not seen, and is dropped without being counted.
    """

    def __init__(self, max_frame_bytes: int = 0) -> None:
        self._max_frame_bytes = max_frame_bytes
        self._fid: int | None = None
        self._in_step = False
        self._chunks: list[bytes] = []
        self._pts: int | None = None
        self._fault: str | None = None
        self._usual: bytes | None = None  # how the packets within the present frame begin: length and flags

    def feed(self, packets: Iterable[Packet]) -> list[ReceivedFrame]:
        """The frames that these packets complete, in order."""
        done: list[ReceivedFrame] = []
        for packet in packets:
            data = packet.data
            # Nearly all of the hundreds of packets of a frame are of this kind, 25 frames a second.
            if packet.arrived and data[:2] == self._usual and len(data) >= data[0]:
                self._chunks.append(data[data[0] :])
            else:
                self._take(packet, done)
        return done

    def _take(self, packet: Packet, done: list[ReceivedFrame]) -> None:
        if not packet.arrived:
            self._fault = self._fault or "a packet was lost on the bus"
            return
        data = packet.data
        if not data:
            return  # an empty micro-frame
        length = data[0]
        if length < _PLAIN_HEADER or length > len(data):
            self._fault = self._fault or f"a packet of {len(data)} bytes says its header has {length}"
            return
        flags = data[1]
        if self._fid is not None and (flags & FID) != self._fid:
            self._finish(done)  # the last packet of the previous frame was lost
            self._in_step = True
        self._fid = flags & FID
        if flags & ERROR:
            self._fault = self._fault or "the camera set the error bit"
        if flags & PTS and length >= _PTS_HEADER and self._pts is None:
            self._pts = int.from_bytes(data[2:6], "little")
        self._chunks.append(data[length:])
        if flags & EOF:
            self._finish(done)
            self._in_step = True
            self._fid = None
        elif not flags & ERROR:
            self._usual = data[:2]

    def _finish(self, done: list[ReceivedFrame]) -> None:
        payload = b"".join(self._chunks)
        if payload and (self._in_step or payload.startswith(b"\xff\xd8")):
            done.append(ReceivedFrame(payload, self._pts, self._fault or self._doubt(payload)))
        elif self._in_step and self._fault:
            done.append(ReceivedFrame(b"", self._pts, self._fault))
        self._chunks, self._pts, self._fault, self._usual = [], None, None, None

    def _doubt(self, payload: bytes) -> str | None:
        if self._max_frame_bytes and len(payload) > self._max_frame_bytes:
            return f"a frame of {len(payload)} bytes; the camera promised at most {self._max_frame_bytes}"
        # A frame begins with a packet: with two starts, the end of this frame and the toggle of the next one were lost.
        if sum(chunk.startswith(b"\xff\xd8\xff") for chunk in self._chunks) > 1:
            return "two frames without a boundary"
        return damage(payload)
