"""USB Video Class as values: request codes, the probe/commit block, and the format descriptors.

Ref: Universal Serial Bus Device Class Definition for Video Devices, revisions 1.0 to 1.5 (tables 3-x for descriptors,
4-47 / 4-75 for the probe block). Nothing here touches a device; `plugins.devices.uvc.stream` does.
"""

import struct
from dataclasses import dataclass
from typing import Self

__all__ = [
    "BLOCK_SIZES",
    "CLASS_VIDEO",
    "COMMIT",
    "GET_CUR",
    "GET_DEF",
    "GET_INFO",
    "GET_LEN",
    "GET_MAX",
    "GET_MIN",
    "GET_RES",
    "PROBE",
    "REQUEST_GET",
    "REQUEST_SET",
    "SET_CUR",
    "SUBCLASS_CONTROL",
    "SUBCLASS_STREAMING",
    "UNITS_PER_SECOND",
    "StreamControl",
    "VideoMode",
    "mjpeg_modes",
]

CLASS_VIDEO, SUBCLASS_CONTROL, SUBCLASS_STREAMING = 0x0E, 0x01, 0x02

# Class-specific requests (UVC 1.5 table A-8) and their bmRequestType for an interface.
SET_CUR, GET_CUR, GET_MIN, GET_MAX = 0x01, 0x81, 0x82, 0x83
GET_RES, GET_LEN, GET_INFO, GET_DEF = 0x84, 0x85, 0x86, 0x87
REQUEST_SET, REQUEST_GET = 0x21, 0xA1

# Selectors of a streaming interface (table A-16).
PROBE, COMMIT = 0x01, 0x02

# Frame intervals count 100 ns (section 3.9.2.1).
UNITS_PER_SECOND = 10_000_000

CS_INTERFACE = 0x24
VS_INPUT_HEADER, VS_FORMAT_MJPEG, VS_FRAME_MJPEG = 0x01, 0x06, 0x07

_BLOCK_10 = struct.Struct("<HBBIHHHHHII")  # 26 bytes, UVC 1.0
_BLOCK_11 = struct.Struct("<IBBBB")  # 8 more from UVC 1.1
BLOCK_SIZES = (26, 34)


@dataclass(frozen=True)
class StreamControl:
    """The probe/commit block: the host's request for the stream, and the camera's answer."""

    format_index: int
    frame_index: int
    frame_interval: int
    """100 ns units."""
    hint: int = 1  # keep the frame interval, derive the others
    max_frame_bytes: int = 0
    """The longest frame."""
    max_payload_bytes: int = 0
    """Bytes per micro-frame, which chooses the alternate setting."""
    clock_frequency: int = 0

    def pack(self, size: int = 26) -> bytes:
        """The block on the bus: 26 bytes for UVC 1.0, 34 from 1.1 on (a camera's answer to GET_LEN)."""
        block = _BLOCK_10.pack(
            self.hint,
            self.format_index,
            self.frame_index,
            self.frame_interval,
            *(0, 0, 0, 0, 0),  # key frame rate, P frame rate, quality, window, delay: unused by MJPEG
            self.max_frame_bytes,
            self.max_payload_bytes,
        ) + _BLOCK_11.pack(self.clock_frequency, 0, 0, 0, 0)
        return block[:size].ljust(size, b"\0")

    @classmethod
    def unpack(cls, block: bytes) -> Self:
        """Read a block of 26 bytes or more. Errors: ValueError when it is shorter."""
        if len(block) < _BLOCK_10.size:
            raise ValueError(f"a probe block has 26 bytes or more, found {len(block)}")
        hint, format_index, frame_index, interval, *_, max_frame, max_payload = _BLOCK_10.unpack_from(block)
        clock = _BLOCK_11.unpack_from(block, _BLOCK_10.size)[0] if len(block) >= 34 else 0
        return cls(format_index, frame_index, interval, hint, max_frame, max_payload, clock)


@dataclass(frozen=True)
class VideoMode:
    """One frame descriptor of an MJPEG format; `intervals` are in 100 ns, the default one first."""

    format_index: int
    frame_index: int
    width: int
    height: int
    max_frame_bytes: int
    intervals: tuple[int, ...]

    @property
    def nominal_fps(self) -> float:
        return UNITS_PER_SECOND / self.intervals[0]


def mjpeg_modes(extra: bytes) -> list[VideoMode]:
    """Read the modes of every MJPEG format in the class-specific descriptors of a streaming interface.

    Errors: ValueError when a descriptor runs past the end or is shorter than its kind allows.
    """
    modes: list[VideoMode] = []
    format_index: int | None = None
    for descriptor in _descriptors(extra):
        if descriptor[1] != CS_INTERFACE:
            continue
        if descriptor[2] == VS_FORMAT_MJPEG:
            if len(descriptor) < 11:
                raise ValueError(f"an MJPEG format descriptor has 11 bytes, found {len(descriptor)}")
            format_index = descriptor[3]
        elif descriptor[2] == VS_FRAME_MJPEG and format_index is not None:
            modes.append(_mode(format_index, descriptor))
    return modes


def _descriptors(extra: bytes) -> list[bytes]:
    descriptors, at = [], 0
    while at < len(extra):
        length = extra[at]
        if length < 3 or at + length > len(extra):
            raise ValueError(
                f"a class-specific descriptor at byte {at} says {length} bytes; {len(extra) - at} are left"
            )
        descriptors.append(extra[at : at + length])
        at += length
    return descriptors


def _mode(format_index: int, descriptor: bytes) -> VideoMode:
    if len(descriptor) < 30:
        raise ValueError(f"an MJPEG frame descriptor has 30 bytes or more, found {len(descriptor)}")
    width, height = struct.unpack_from("<HH", descriptor, 5)
    max_frame, default = struct.unpack_from("<II", descriptor, 17)
    count = descriptor[25]
    # A type of 0 is a continuous range (min, max, step); it contains the default, which is requested.
    others = struct.unpack_from(f"<{count}I", descriptor, 26) if len(descriptor) >= 26 + 4 * count else ()
    intervals = (default, *(i for i in others if i != default))
    return VideoMode(format_index, descriptor[3], width, height, max_frame, intervals)
