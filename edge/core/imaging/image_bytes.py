"""Encoded pictures as bytes: is a JPEG or PNG complete, how large is it, and is it a repeat of the last one.

Nothing is decoded here, so these checks take microseconds and can run on every frame.
"""

import struct
import zlib

__all__ = ["Freshness", "comment", "damage", "kind", "picture_size", "with_comment"]

_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_COM, _TEXT = b"\xff\xfe", b"tEXtComment\0"
# The signature (8), then IHDR, which always comes first: 13 bytes with 12 around them.
_PNG_AFTER_HEADER = 33
# SOF0..SOF15 without DHT (C4), JPG (C8) and DAC (CC): ITU-T T.81, table B.1.
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Markers without a length field: TEM and RST0..RST7 (T.81, table B.1).
_BARE_MARKERS = frozenset({0x01, *range(0xD0, 0xD8)})


def kind(payload: bytes) -> str | None:
    """`jpg` or `png` by its first bytes, else None."""
    if payload.startswith(_SOI):
        return "jpg"
    return "png" if payload.startswith(_PNG_SIGNATURE) else None


def damage(payload: bytes) -> str | None:
    """Say why these bytes are not one complete JPEG or PNG, or None when both ends are present.

    Cameras may pad a JPEG with zero bytes, so only zeros are allowed after its end. A gap in the middle is not detected
    here; the transport must report it.
    """
    match kind(payload):
        case "jpg":
            end = payload.rfind(_EOI)
            if end < 0:
                return f"a JPEG of {len(payload)} bytes without its end marker FFD9"
            tail = payload[end + 2 :]
            return f"a JPEG with {len(tail)} bytes after its end marker" if any(tail) else None
        case "png":
            return (
                None
                if payload.endswith(_PNG_END)
                else f"a PNG of {len(payload)} bytes without its IEND chunk"
            )
        case _:
            return f"{len(payload)} bytes starting {payload[:4].hex() or 'nowhere'}, neither a JPEG (FFD8) nor a PNG"


def picture_size(payload: bytes) -> tuple[int, int] | None:
    """(width, height) from the header of a JPEG or PNG, or None when it cannot be read."""
    if kind(payload) == "png":
        return struct.unpack(">II", payload[16:24]) if len(payload) >= 24 else None
    return _jpeg_size(payload) if kind(payload) == "jpg" else None


def _jpeg_size(payload: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(payload) and payload[at] == 0xFF:
        marker = payload[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker in _BARE_MARKERS:
            at += 2
        elif marker in _START_OF_FRAME:
            height, width = struct.unpack_from(">HH", payload, at + 5)
            return width, height
        else:
            at += 2 + int(struct.unpack_from(">H", payload, at + 2)[0])
    return None


def with_comment(payload: bytes, text: str) -> bytes:
    """Put a comment at the picture's front: a JPEG COM segment (T.81 B.2.4.5) or a PNG tEXt chunk (11.3.4.3).

    No pixel changes, but the bytes differ, so a copy is not taken for a frame that a hung camera sends twice.
    """
    body = text.encode("ascii")
    if kind(payload) == "jpg":
        return payload[:2] + _COM + struct.pack(">H", len(body) + 2) + body + payload[2:]
    chunk = _TEXT + body
    length, check = struct.pack(">I", len(chunk) - 4), struct.pack(">I", zlib.crc32(chunk))
    return payload[:_PNG_AFTER_HEADER] + length + chunk + check + payload[_PNG_AFTER_HEADER:]


def comment(payload: bytes) -> str | None:
    """The comment that `with_comment` put at the front, or None."""
    if kind(payload) == "jpg" and payload[2:4] == _COM:
        return payload[6 : 4 + int.from_bytes(payload[4:6], "big")].decode("ascii", "replace")
    start = _PNG_AFTER_HEADER + 4
    if kind(payload) == "png" and payload[start : start + len(_TEXT)] == _TEXT:
        length = int.from_bytes(payload[_PNG_AFTER_HEADER:start], "big")
        return payload[start + len(_TEXT) : start + 4 + length].decode("ascii", "replace")
    return None


class Freshness:
    """Distinguishes a new frame from a repeat of the last one.

    A camera that hangs, or a driver that serves its buffer twice, gives byte-identical payloads; sensor noise makes
    that impossible for two real exposures. `stale` counts the repeats.
    """

    def __init__(self) -> None:
        self.stale = 0
        self._last = b""

    def is_new(self, payload: bytes) -> bool:
        if payload == self._last:
            self.stale += 1
            return False
        self._last = payload
        return True
