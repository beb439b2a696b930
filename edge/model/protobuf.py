"""Writes protobuf fields, so that ONNX graphs are cut and extended without the onnx package.

Ref: protobuf encoding guide (wire types).
"""

from collections.abc import Iterator

__all__ = ["Field", "encode_field", "message"]

_BYTES = 2  # wire type of a length-delimited field

Field = tuple[int, int | bytes | memoryview | str]
"""A field's number and its value: an int is a varint, anything else is length-delimited."""


def message(*content: Field) -> bytes:
    """The fields one after the other."""
    return b"".join(encode_field(number, value) for number, value in content)


def encode_field(number: int, value: int | bytes | memoryview | str) -> bytes:
    """Encode one field of a message."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else bytes(value)
    return _varint(number << 3 | _BYTES) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    return bytes(_groups(value))


def _groups(value: int) -> Iterator[int]:
    while value > 0x7F:
        yield value & 0x7F | 0x80
        value >>= 7
    yield value
