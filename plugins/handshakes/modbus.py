"""A Modbus TCP server for the handshake with a PLC.

Ref: MODBUS Application Protocol Specification V1.1b3; MODBUS Messaging on TCP/IP Implementation Guide V1.0b.

The server is ours: that of pymodbus (3.16.1) answers one of several requests that come in one segment and drops the
others, says to its data store not who writes, and changes the store's interface between minor versions. The tests use
the clients of others.

What it does not do: no serial line, no encryption, no login; functions other than 1 to 6, 15 and 16.
"""

import logging
import select
import socket
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from socketserver import BaseRequestHandler, ThreadingTCPServer
from typing import Any, Final

from pydantic import BaseModel, Field

from edge.core.errors import ConfigError
from edge.core.handshake import Code, Handshake
from edge.core.plugins import HandshakePlugin
from edge.core.ports import Clock
from edge.core.rate import Rate
from plugins.handshakes.registers import COILS, HOLDING, input_registers, read_trigger, status_bits

__all__ = ["Modbus", "ModbusOptions", "ModbusServer", "plugin"]

log = logging.getLogger(__name__)

# Who writes keeps that right while it asks anything, and this long after.
WRITER_S: Final = 3.0
# A request that has begun comes to its end within this time, and its answer is taken.
REQUEST_S: Final = 5.0
# A PLC has one or two. Those of a pulled cable are ended by the kernel after some ten seconds, but not where something
# between still answers for the PLC: one more takes the place of the one that is silent longest.
MOST_CONNECTIONS: Final = 32
LOOK_S: Final = 0.1
# Whoever connects again and again, such as a scanner or a health check, does not fill the log.
LINES_PER_MINUTE: Final = 6

_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _DEVICE_FAILURE, _BUSY = 1, 2, 3, 4, 6

# Why a trigger is refused, as a Modbus exception.
_EXCEPTIONS: Final[Mapping[Code, int]] = {
    Code.BUSY: _BUSY,
    Code.NOT_ACKNOWLEDGED: _BUSY,
    Code.NOT_READY: _DEVICE_FAILURE,
    Code.NO_BEAT: _DEVICE_FAILURE,
}
_TRIGGER, _ACKNOWLEDGE, _WATCHDOG = range(len(COILS))
_READ: Final = {1: "coils", 2: "discrete inputs", 3: "holding registers", 4: "input registers"}
_HOLDING_COUNT: Final = sum(count for count, _ in HOLDING.values())


class ModbusOptions(BaseModel, extra="forbid", frozen=True):
    """Where a PLC finds the registers of plc.md. Whoever reaches the port can ask for everything there."""

    host: str = Field(
        default="127.0.0.1",
        min_length=1,
        description="the address of this machine at which the PLC asks; by default this machine alone",
    )
    port: int = Field(
        default=1502,
        ge=1,
        le=65535,
        description="TCP port; below 1024 the service needs the right CAP_NET_BIND_SERVICE. Modbus's own is 502",
    )


class _Refused(Exception):
    """A request is answered with this exception code. sentence: what is recorded; None where it is already."""

    def __init__(self, code: int, sentence: str | None = None) -> None:
        super().__init__(sentence)
        self.code, self.sentence = code, sentence


class _Registers:
    """The registers of one station, for all its connections. What a PLC writes is used by one thread at a time."""

    def __init__(self, handshake: Handshake, clock: Clock) -> None:
        self._handshake, self._clock = handshake, clock
        self._lock = threading.Lock()
        self._coils: list[bool | None] = [None] * len(COILS)  # None until this writer has written it
        self._holding = [0] * _HOLDING_COUNT
        self._writer: _Connection | None = None
        self._writer_ip = ""
        self._heard_ns = 0

    def answer(self, request: bytes, client: "_Connection", ip: str) -> bytes:
        """Return the response to one request, both without their header. client: the connection."""
        function = request[0]
        try:
            with self._lock:
                if client is self._writer:
                    self._heard_ns = self._clock.monotonic_ns()
                do = self._FUNCTIONS.get(function)
                if do is None:
                    raise _Refused(
                        _ILLEGAL_FUNCTION, f"function {function} of {ip} is not served; use 1 to 6, 15, 16"
                    )
                try:
                    return request[:1] + do(self, request, client, ip)
                except struct.error:
                    raise _Refused(
                        _ILLEGAL_VALUE, f"a request of {ip} for function {function} has a wrong length"
                    ) from None
        except _Refused as refused:
            if refused.sentence is not None:
                what = "read" if function <= 4 else "write"
                self._handshake.refuse(what, f"{refused.sentence} (docs/plc.md)")
            return bytes([function | 0x80, refused.code])

    def forget(self, client: "_Connection") -> None:
        """A connection has ended; another one may write now."""
        with self._lock:
            if client is self._writer:
                self._writer = None

    def _read_bits(self, request: bytes, client: "_Connection", ip: str) -> bytes:
        bits = status_bits(self._handshake.read()) if request[0] == 2 else list(map(bool, self._coils))
        start, count = struct.unpack(">HH", request[1:])
        _check_range(_READ[request[0]], start, count, len(bits), 2000, ip)
        word, size = sum(bit << n for n, bit in enumerate(bits[start : start + count])), (count + 7) // 8
        return bytes([size]) + word.to_bytes(size, "little")

    def _read_registers(self, request: bytes, client: "_Connection", ip: str) -> bytes:
        words = input_registers(self._handshake.read()) if request[0] == 4 else self._holding
        start, count = struct.unpack(">HH", request[1:])
        _check_range(_READ[request[0]], start, count, len(words), 125, ip)
        return struct.pack(f">B{count}H", 2 * count, *words[start : start + count])

    def _write_coil(self, request: bytes, client: "_Connection", ip: str) -> bytes:
        start, value = struct.unpack(">HH", request[1:])
        if value not in (0x0000, 0xFF00):
            raise _Refused(_ILLEGAL_VALUE, f"a coil is written by {ip} as {value:#06x}, expected 0 or 0xff00")
        self._set_coils(start, [value != 0], client, ip)
        return request[1:]

    def _write_coils(self, request: bytes, client: "_Connection", ip: str) -> bytes:
        start, count, size = struct.unpack(">HHB", request[1:6])
        packed = request[6:]
        if size != len(packed) or size != (count + 7) // 8:
            raise struct.error
        bits = [bool(packed[n // 8] >> n % 8 & 1) for n in range(count)]
        self._set_coils(start, bits, client, ip)
        return request[1:5]

    def _write_register(self, request: bytes, client: "_Connection", ip: str) -> bytes:
        start, value = struct.unpack(">HH", request[1:])
        self._set_holding(start, [value], client, ip)
        return request[1:]

    def _write_registers(self, request: bytes, client: "_Connection", ip: str) -> bytes:
        start, count, size = struct.unpack(">HHB", request[1:6])
        if size != 2 * count:
            raise struct.error
        self._set_holding(start, struct.unpack(f">{count}H", request[6:]), client, ip)
        return request[1:5]

    _FUNCTIONS: Final[Mapping[int, Callable[["_Registers", bytes, "_Connection", str], bytes]]] = {
        1: _read_bits,
        2: _read_bits,
        3: _read_registers,
        4: _read_registers,
        5: _write_coil,
        6: _write_register,
        15: _write_coils,
        16: _write_registers,
    }

    def _set_holding(self, start: int, words: Sequence[int], client: "_Connection", ip: str) -> None:
        _check_range("holding registers", start, len(words), _HOLDING_COUNT, 123, ip)
        self._admit(client, ip)
        self._holding[start : start + len(words)] = words

    def _set_coils(self, start: int, bits: Sequence[bool], client: "_Connection", ip: str) -> None:
        """Take the edges of coils that a PLC may write all the time. The trigger is last: it may be refused."""
        _check_range("coils", start, len(bits), len(COILS), 1968, ip)
        self._admit(client, ip)
        written = dict(enumerate(bits, start))
        if (beat := written.get(_WATCHDOG)) is not None:
            if self._coils[_WATCHDOG] == (not beat):
                self._handshake.beat()
            self._coils[_WATCHDOG] = beat
        if (is_read := written.get(_ACKNOWLEDGE)) is not None:
            if is_read and not self._coils[_ACKNOWLEDGE]:
                self._handshake.acknowledge()
            self._coils[_ACKNOWLEDGE] = is_read
        if (is_wanted := written.get(_TRIGGER)) is not None:
            if is_wanted and not self._coils[_TRIGGER]:
                self._trigger(ip)
            self._coils[_TRIGGER] = is_wanted

    def _trigger(self, ip: str) -> None:
        if self._coils[_TRIGGER] is None:
            self._handshake.refuse(
                "trigger",
                f"the trigger of {ip} is 1 from the beginning, which may be one of before; write it 0 first "
                "(docs/plc.md)",
            )
            raise _Refused(_ILLEGAL_VALUE)
        refusal = self._handshake.trigger(read_trigger(self._holding))
        if refusal is not None:
            raise _Refused(_EXCEPTIONS.get(refusal.code, _ILLEGAL_VALUE))

    def _admit(self, client: "_Connection", ip: str) -> None:
        """Let one client write at a time. One at another address finds nothing that the one before has written."""
        now_ns = self._clock.monotonic_ns()
        if client is self._writer:
            return
        is_heard = now_ns - self._heard_ns <= WRITER_S * 1e9
        if self._writer is not None and is_heard and not self._writer.is_gone:
            raise _Refused(
                _BUSY,
                f"a second client, at {ip}, writes while the one at {self._writer_ip} does; it may read, and write "
                f"{WRITER_S:g} s after the other's last request",
            )
        if ip != self._writer_ip:
            self._coils = [None] * len(COILS)
            self._holding = [0] * _HOLDING_COUNT
        self._writer, self._writer_ip, self._heard_ns = client, ip, now_ns


def _check_range(what: str, start: int, count: int, have: int, most: int, ip: str) -> None:
    if not 1 <= count <= most:
        raise _Refused(_ILLEGAL_VALUE, f"{ip} asks for {count} {what} at once, expected 1 to {most}")
    if start + count > have:
        raise _Refused(
            _ILLEGAL_ADDRESS,
            f"{ip} asks for {what} {start} to {start + count - 1}, where the map has 0 to {have - 1}",
        )


class _Connection(BaseRequestHandler):
    """One client: its requests are answered one after another, in their order."""

    server: "ModbusServer"
    request: socket.socket

    def setup(self) -> None:
        for option, value in (
            (socket.TCP_NODELAY, 1),
            (socket.TCP_KEEPIDLE, 5),
            (socket.TCP_KEEPINTVL, 2),
            (socket.TCP_KEEPCNT, 3),
        ):
            self.request.setsockopt(socket.IPPROTO_TCP, option, value)
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    def handle(self) -> None:
        ip, registers = str(self.client_address[0]), self.server.registers
        try:
            while registers is not None and (header := self._receive(7, is_first=True)):
                transaction, protocol, length, unit = struct.unpack(">HHHB", header)
                if protocol != 0 or not 2 <= length <= 254:
                    self.server.warn(f"what {ip} sends is no Modbus TCP; its connection is ended")
                    return
                answer = registers.answer(self._receive(length - 1), self, ip)
                self.server.hear(self.request)
                self.request.sendall(struct.pack(">HHHB", transaction, 0, len(answer) + 1, unit) + answer)
        except (OSError, EOFError):  # a cable that is pulled, or a client that stops in the middle
            return

    @property
    def is_gone(self) -> bool:
        """True where the client has closed, though its thread may not know it yet."""
        poll = select.poll()
        try:
            poll.register(self.request, select.POLLRDHUP)
        except (OSError, ValueError):  # its thread has closed it just now
            return True
        return bool(poll.poll(0))

    def finish(self) -> None:
        if self.server.registers is not None:
            self.server.registers.forget(self)

    def _receive(self, size: int, *, is_first: bool = False) -> bytes:
        """Return so many bytes; none where the client has closed before the first. Errors: EOFError, OSError."""
        received = b""
        self.request.settimeout(None if is_first else REQUEST_S)
        while len(received) < size:
            more = self.request.recv(size - len(received))
            self.request.settimeout(REQUEST_S)
            if not more:
                if is_first and not received:
                    return b""
                raise EOFError
            received += more
        return received


class ModbusServer(ThreadingTCPServer):
    """A `HandshakeServer`. port 0: a free one. Errors: OSError for an address that cannot be taken."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        self.registers: _Registers | None = None
        self._clock = clock
        self._open: dict[socket.socket, None] = {}  # the one that is silent longest first
        self._open_lock = threading.Lock()
        self._lines = Rate(LINES_PER_MINUTE, clock)
        self._thread = threading.Thread(target=self.serve_forever, args=(LOOK_S,), name="modbus", daemon=True)
        super().__init__((host, port), _Connection)

    @property
    def name(self) -> str:
        host, port = self.socket.getsockname()[:2]
        return f"Modbus TCP at {host}:{port}"

    @property
    def has_ended(self) -> bool:
        return self._thread.ident is not None and not self._thread.is_alive()

    def start(self, handshake: Handshake) -> None:
        self.registers = _Registers(handshake, self._clock)
        self._thread.start()

    def close(self) -> None:
        if self._thread.is_alive():
            self.shutdown()
            self._thread.join()
        self.server_close()
        with self._open_lock:
            for connection in self._open:
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def warn(self, sentence: str) -> None:
        """Have it in the log, unless that has enough of this minute."""
        if self._lines.take():
            log.warning("%s", sentence)

    def hear(self, request: socket.socket) -> None:
        """A connection has asked something."""
        with self._open_lock:
            if request in self._open:
                self._open[request] = self._open.pop(request)

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._open_lock:
            if len(self._open) >= MOST_CONNECTIONS:
                silent = next(iter(self._open))
                del self._open[silent]
                self.warn(
                    f"{MOST_CONNECTIONS} connections are open; the one that is silent longest is ended for "
                    f"{client_address[0]}"
                )
                with suppress(OSError):  # its thread ends it
                    silent.shutdown(socket.SHUT_RDWR)
            self._open[request] = None
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._open_lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        log.exception("the Modbus request of %s failed; its connection is ended", client_address[0])


class Modbus(HandshakePlugin[ModbusOptions]):
    """The plugin."""

    Options = ModbusOptions

    def open(self, options: ModbusOptions, clock: Clock) -> ModbusServer:
        try:
            return ModbusServer(options.host, options.port, clock)
        except OSError as error:
            raise ConfigError(
                f"handshake.options: {options.host}:{options.port} cannot be served ({error.strerror or error}); "
                "choose another port or an address of this machine, or end what uses it"
            ) from error


plugin = Modbus()
