"""MQTT packets of both levels, as a broker reads and writes them. Ref: MQTT 5.0 and 3.1.1 (OASIS), chapters 2 and 3."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from edge.core.ports import Message

CONNECT, CONNACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK, PINGREQ, PINGRESP, DISCONNECT = (
    1,
    2,
    3,
    4,
    8,
    9,
    12,
    13,
    14,
)
TAKEN_OVER, TOO_LARGE, NOT_AUTHORIZED, OTHER_LEVEL = 0x8E, 0x95, 0x87, 0x84
REFUSED_AT_3 = {NOT_AUTHORIZED: 5, OTHER_LEVEL: 1}
"""CONNACK's codes of level 3.1.1."""


@dataclass(frozen=True)
class Connect:
    """What a client says of itself."""

    level: str
    client_id: str
    will: Message | None
    is_clean: bool
    """What the broker has kept of it is to be forgotten."""
    expiry_s: float
    """So long after the end of the connection the broker keeps what it knows of it."""


@dataclass(frozen=True)
class Publish:
    """A message, and the number under which it is acknowledged; 0 where it is not."""

    message: Message
    number: int


def take_packets(data: bytearray) -> Iterator[tuple[int, bytes]]:
    """Take the whole packets off the begin: the first byte, and what follows the length."""
    while len(data) > 1:
        length, at = _length(data, 1)
        end = at + length
        if at > len(data) or end > len(data):
            return
        first, body = data[0], bytes(data[at:end])
        del data[:end]
        yield first, body


def read_connect(body: bytes) -> Connect:
    """Read a CONNECT."""
    level, flags, at = ("5" if body[6] == 5 else "3.1.1"), body[7], 10
    is_clean = bool(flags & 0x02)
    expiry_s = 0.0 if is_clean else math.inf
    if level == "5":
        said = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        said.unpack(body[at:])  # type: ignore[no-untyped-call]
        expiry_s, at = getattr(said, "SessionExpiryInterval", 0.0), _skip(body, at)
    client_id, at = _field(body, at)
    will = None
    if flags & 0x04:
        if level == "5":
            at = _skip(body, at)
        topic, at = _field(body, at)
        payload, at = _field(body, at)
        will = Message(topic.decode(), payload, flags >> 3 & 3, bool(flags & 0x20))
    return Connect(level, client_id.decode(), will, is_clean, expiry_s)


def read_publish(first: int, body: bytes, level: str) -> Publish:
    """Read a PUBLISH."""
    topic, at = _field(body, 0)
    qos, number = first >> 1 & 3, 0
    if qos:
        number, at = int.from_bytes(body[at : at + 2], "big"), at + 2
    if level == "5":
        at = _skip(body, at)
    return Publish(Message(topic.decode(), body[at:], qos, bool(first & 1)), number)


def packet(kind: int, body: bytes = b"", flags: int = 0) -> bytes:
    """Write a packet."""
    length, parts = len(body), bytearray()
    while True:
        length, low = divmod(length, 128)
        parts.append(low | (0x80 if length else 0))
        if not length:
            return bytes([kind << 4 | flags]) + bytes(parts) + body


def connack(level: str, code: int = 0, largest: int | None = None, *, is_kept: bool = False) -> bytes:
    """Accept or refuse a connection. largest: packet in bytes, which only level 5 can say. is_kept: what the broker
    knows of the client's last connection goes on."""
    if level != "5":
        return packet(CONNACK, bytes([is_kept, REFUSED_AT_3.get(code, code)]))
    said = Properties(PacketTypes.CONNACK)  # type: ignore[no-untyped-call]
    if largest is not None:
        said.MaximumPacketSize = largest
    return packet(CONNACK, bytes([is_kept, code]) + said.pack())  # type: ignore[no-untyped-call]


def puback(level: str, number: int, code: int = 0) -> bytes:
    """Acknowledge a message, or refuse it, which only level 5 can say."""
    return packet(PUBACK, number.to_bytes(2, "big") + (bytes([code]) if code and level == "5" else b""))


def suback(level: str, body: bytes) -> bytes:
    """Accept a SUBSCRIBE of one filter at QoS 1."""
    return packet(SUBACK, body[:2] + (b"\x00" if level == "5" else b"") + b"\x01")


def publish(level: str, topic: str, payload: bytes, response_topic: str | None = None) -> bytes:
    """Write a message of QoS 0. response_topic: only level 5 can say it."""
    said = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    if response_topic is not None:
        said.ResponseTopic = response_topic
    properties = said.pack() if level == "5" else b""  # type: ignore[no-untyped-call]
    return packet(PUBLISH, len(topic.encode()).to_bytes(2, "big") + topic.encode() + properties + payload)


def _field(body: bytes, at: int) -> tuple[bytes, int]:
    end = at + 2 + int.from_bytes(body[at : at + 2], "big")
    return body[at + 2 : end], end


def _length(data: bytes | bytearray, at: int) -> tuple[int, int]:
    """Read a length, low digits first; returns it, and where what follows begins: behind the end where it is cut."""
    length = shift = 0
    while at < len(data):
        length |= (data[at] & 0x7F) << shift
        if not data[at] & 0x80:
            return length, at + 1
        at, shift = at + 1, shift + 7
    return length, at + 1


def _skip(body: bytes, at: int) -> int:
    """Go past the properties, of which a broker here needs none."""
    length, at = _length(body, at)
    return at + length
