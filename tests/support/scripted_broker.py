"""A broker that does as a test says: how it answers each CONNECT, and each topic.

It reads whole MQTT packets of both levels and knows no subscriber. Ref: MQTT 5.0 and 3.1.1, chapter 3.
"""

import contextlib
import socket
import threading
from dataclasses import dataclass, field
from typing import Self

CONNECT, PUBLISH, SUBSCRIBE, PINGREQ, DISCONNECT = 1, 3, 8, 12, 14
NOT_AUTHORIZED, UNSUPPORTED = 0x87, 0x84


@dataclass
class ScriptedBroker:
    """connects: what the next CONNECTs get, `accept` when it is used up: accept, silent, close, refuse (this level).
    silent_at_5: no CONNECT of level 5 is answered. topics: last level of a topic to deny, silent or close; others are
    acknowledged."""

    connects: list[str] = field(default_factory=list)
    topics: dict[str, str] = field(default_factory=dict)
    silent_at_5: bool = False
    answers_pings: bool = True
    levels: list[str] = field(default_factory=list)
    published: list[tuple[str, bytes]] = field(default_factory=list)
    properties: list[bytes] = field(default_factory=list)
    subscriptions: list[bytes] = field(default_factory=list)

    def __enter__(self) -> Self:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._sockets: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._threads[0].join()  # it may have one in hand
        for one in self._sockets:
            _end(one)
        for thread in self._threads:
            thread.join(10)

    def send(self, topic: str, payload: bytes) -> None:
        """Deliver a message to the client that connected last."""
        level = self.levels[-1]
        body = _text(topic) + (b"\x00" if level == "5" else b"") + payload
        self._sockets[-1].sendall(bytes([PUBLISH << 4]) + _length(len(body)) + body)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                one, _ = self._server.accept()
                self._sockets.append(one)
                self._threads.append(threading.Thread(target=self._serve, args=(one,)))
                self._threads[-1].start()

    def _serve(self, one: socket.socket) -> None:
        level = "5"
        with contextlib.suppress(OSError, EOFError):
            while True:
                kind, body = _packet(one)
                if kind >> 4 == CONNECT:
                    level = "5" if body[6] == 5 else "3.1.1"
                    self._connect(one, level, body)
                elif kind >> 4 == PUBLISH:
                    self._take(one, level, kind, body)
                elif kind >> 4 == SUBSCRIBE:
                    self.subscriptions.append(body)
                    denied = self.topics.get("cmd") == "deny"
                    code = NOT_AUTHORIZED if denied and level == "5" else 0x80 if denied else 1
                    middle = b"\x00" if level == "5" else b""
                    _answer(one, 0x90, body[:2] + middle + bytes([code]))
                elif kind >> 4 == PINGREQ and self.answers_pings:
                    _answer(one, 0xD0, b"")
                elif kind >> 4 == DISCONNECT:
                    _end(one)
                    return

    def _connect(self, one: socket.socket, level: str, body: bytes) -> None:
        self.levels.append(level)
        self.properties.append(body[10:])
        silent = self.silent_at_5 and level == "5"
        what = "silent" if silent else self.connects.pop(0) if self.connects else "accept"
        tail = b"\x00" if level == "5" else b""
        if what == "close":
            _end(one)
        elif what == "refuse":
            _answer(one, 0x20, bytes([0, UNSUPPORTED if level == "5" else 1]) + tail)
        elif what == "accept":
            _answer(one, 0x20, b"\x00\x00" + tail)

    def _take(self, one: socket.socket, level: str, kind: int, body: bytes) -> None:
        length = int.from_bytes(body[:2], "big")
        topic = body[2 : 2 + length].decode()
        has_id = bool(kind & 0b110)
        packet_id = body[2 + length : 4 + length] if has_id else b""
        at = 2 + length + len(packet_id)
        if level == "5":
            at += 1 + body[at]  # our properties are shorter than 128 bytes
        what = self.topics.get(topic.rpartition("/")[2], "accept")
        if what == "accept":
            self.published.append((topic, body[at:]))
        if what == "close":
            _end(one)
        elif what != "silent" and has_id:
            denied = what == "deny" and level == "5"
            _answer(one, 0x40, packet_id + (bytes([NOT_AUTHORIZED]) if denied else b""))


def _packet(one: socket.socket) -> tuple[int, bytes]:
    kind, length, shift = _exactly(one, 1)[0], 0, 0
    while True:
        byte = _exactly(one, 1)[0]
        length |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return kind, _exactly(one, length)


def _exactly(one: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        part = one.recv(count - len(data))
        if not part:
            raise EOFError
        data += part
    return data


def _answer(one: socket.socket, kind: int, body: bytes) -> None:
    one.sendall(bytes([kind]) + _length(len(body)) + body)


def _length(number: int) -> bytes:
    parts = []
    while True:
        number, low = divmod(number, 128)
        parts.append(low | (0x80 if number else 0))
        if not number:
            return bytes(parts)


def _text(text: str) -> bytes:
    return len(text.encode()).to_bytes(2, "big") + text.encode()


def _end(one: socket.socket) -> None:
    with contextlib.suppress(OSError):
        one.shutdown(socket.SHUT_RDWR)
    one.close()
