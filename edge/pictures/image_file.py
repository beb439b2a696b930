"""Picture files with texts in them, PNG or JPEG: OpenCV writes the pixels, this module adds the texts.

Ref: PNG specification, third edition (W3C), 11.3.3.4 iTXt: UTF-8 text under a Latin-1 keyword of 1 to 79 bytes.
ITU-T T.81, B.2.4.5 COM: a comment of at most 65533 bytes; here one JSON object, in ASCII.
"""

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.imaging.image_bytes import kind

__all__ = ["PictureForm", "content_type", "encode", "encode_jpeg", "texts"]

PictureForm = Literal["jpeg", "png"]

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_FIRST_CHUNK: Final = len(_SIGNATURE) + 4 + 4 + 13 + 4  # the header chunk, which must be the first, ends here

# zlib level: 1 takes a third of the time of the default on such pictures, for a tenth more bytes.
_LEVEL: Final = 1

_JPEG_BEGIN: Final = b"\xff\xd8"
_COMMENT: Final = 0xFE
_SCAN: Final = 0xDA  # the pixels begin; no segment before them is left

# Letters of the sheets stay sharp; half of the bytes of OpenCV's 95.
_QUALITY: Final = 85


def encode(pixels: NDArray[np.uint8 | np.uint16], text: Mapping[str, str] | None = None) -> bytes:
    """Write a PNG with these texts. pixels: RGB uint8 (h, w, 3), or grey uint8 or uint16 (h, w). Errors: ValueError
    when OpenCV cannot encode it."""
    png = _write(pixels, "png", _LEVEL)
    chunks = b"".join(_text_chunk(keyword, value) for keyword, value in (text or {}).items())
    return png[:_FIRST_CHUNK] + chunks + png[_FIRST_CHUNK:]


def encode_jpeg(rgb: NDArray[np.uint8], text: Mapping[str, str]) -> bytes:
    """Write a JPEG, uint8 (h, w, 3), whose comment has these texts. Errors: as `encode`."""
    jpeg = _write(rgb, "jpeg", _QUALITY)
    comment = json.dumps(dict(text)).encode()
    return _JPEG_BEGIN + struct.pack(">BBH", 0xFF, _COMMENT, len(comment) + 2) + comment + jpeg[2:]


def texts(data: bytes) -> dict[str, str]:
    """Read the texts in a PNG or a JPEG, keyword to text. Errors: ValueError for bytes that are neither, and for texts
    that cannot be read."""
    try:
        if content_type(data) == "image/jpeg":
            comment = json.loads(next((body for code, body in _segments(data) if code == _COMMENT), b"{}"))
            return {str(keyword): str(text) for keyword, text in comment.items()}
        entries = {}
        for name, body in _chunks(data):
            if name == b"iTXt":
                keyword, _, rest = body.partition(b"\0")
                entries[keyword.decode("latin-1")] = rest[2:].split(b"\0", 2)[2].decode()
        return entries
    except (AttributeError, IndexError, RecursionError) as error:
        raise ValueError("its texts cannot be read") from error


def content_type(data: bytes) -> str:
    """Say what a picture is by its first bytes: at MQTT 3.1.1 nothing else does. Errors: ValueError for another."""
    match kind(data):
        case "jpg":
            return "image/jpeg"
        case "png":
            return "image/png"
    raise ValueError(f"not a PNG and not a JPEG: it begins with {data[:8]!r}")


def _write(pixels: NDArray[np.uint8 | np.uint16], form: PictureForm, level: int) -> bytes:
    import cv2  # subscribers read files and write none: they start without it

    how = (cv2.IMWRITE_PNG_COMPRESSION if form == "png" else cv2.IMWRITE_JPEG_QUALITY, level)
    ordered = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    encoded, data = cv2.imencode(f".{form}", ordered, list(how))
    if not encoded:
        raise ValueError(f"a picture of shape {pixels.shape} cannot be encoded as {form}")
    return data.tobytes()


def _text_chunk(keyword: str, text: str) -> bytes:
    # After the keyword: not compressed (0), method 0, no language tag, no translated keyword.
    data = keyword.encode("latin-1") + b"\0" + b"\0\0" + b"\0" + b"\0" + text.encode()
    return struct.pack(">I", len(data)) + b"iTXt" + data + struct.pack(">I", zlib.crc32(b"iTXt" + data))


def _chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    position = len(_SIGNATURE)
    while position + 12 <= len(png):
        (length,) = struct.unpack_from(">I", png, position)
        yield png[position + 4 : position + 8], png[position + 8 : position + 8 + length]
        position += 12 + length


def _segments(jpeg: bytes) -> Iterator[tuple[int, bytes]]:
    """The segments before the pixels: code and content."""
    position = len(_JPEG_BEGIN)
    while position + 4 <= len(jpeg) and jpeg[position] == 0xFF and jpeg[position + 1] != _SCAN:
        (length,) = struct.unpack_from(">H", jpeg, position + 2)
        yield jpeg[position + 1], jpeg[position + 4 : position + 2 + length]
        position += 2 + length
