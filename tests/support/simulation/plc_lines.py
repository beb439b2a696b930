"""The two servers that a PLC may ask, each with the calls that stand for a request: no packet is made.

The registers and the nodes are those of the program. A session of OPC UA is known by what the server looks at.
"""

import asyncio
import struct
from collections.abc import Collection
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from edge.core.handshake import Handshake
from edge.core.ports import Clock
from plugins.handshakes.modbus import _Registers
from plugins.handshakes.nodes import METHODS, VARIABLES
from plugins.handshakes.opcua import OpcUaServer, _caller
from plugins.handshakes.registers import STATUS_BITS

if TYPE_CHECKING:
    from simulation.surroundings import SimulatedClock

TRIGGER, ACKNOWLEDGE, WATCHDOG = 0, 1, 2

Seen = tuple[Collection[str], int]
"""The names of the bits that are set, and the id, of one request."""


class Line:
    """A connection, or a session, of one client, as the server sees it."""

    def __init__(self, clock: "SimulatedClock", ip: str) -> None:
        self.clock, self.ip, self.name = clock, ip, ip
        self.is_gone = False
        self.heard_ns = 0

    def is_activated(self) -> bool:
        return not self.is_gone


class ModbusPort:
    """The registers of one life."""

    def __init__(self, handshake: Handshake, clock: Clock) -> None:
        self._registers = _Registers(handshake, clock)

    def forget(self, line: Line) -> None:
        self._registers.forget(line)  # type: ignore[arg-type]  # a line in place of a connection

    def read(self, line: Line) -> Seen:
        bits, high, low = struct.unpack(">HHH", self._ask(line, struct.pack(">BHH", 4, 0, 3))[2:])
        return [name for bit, (name, _, _) in enumerate(STATUS_BITS) if bits >> bit & 1], high << 16 | low

    def load(self, line: Line, number: int, piece: str, part: str) -> bool:
        words = struct.pack(">I32s32s", number, piece.encode(), part.encode())
        return self._ask(line, struct.pack(">BHHB", 16, 0, len(words) // 2, len(words)) + words)[0] == 16

    def trigger(self, line: Line, number: int, piece: str, part: str) -> bool:
        return self._write(line, TRIGGER, [True])

    def acknowledge(self, line: Line) -> bool:
        return self._write(line, ACKNOWLEDGE, [True])

    def lower(self, line: Line) -> bool:
        return self._write(line, TRIGGER, [False, False])

    def beat(self, line: Line, is_high: bool) -> bool:
        return self._write(line, WATCHDOG, [is_high])

    def _write(self, line: Line, start: int, bits: list[bool]) -> bool:
        packed = sum(bit << n for n, bit in enumerate(bits))
        return self._ask(line, struct.pack(">BHHBB", 15, start, len(bits), 1, packed))[0] == 15

    def _ask(self, line: Line, request: bytes) -> bytes:
        return self._registers.answer(request, line, line.ip)  # type: ignore[arg-type]


class _Nodes(OpcUaServer):
    """Without a socket and a thread."""

    def __init__(self, handshake: Handshake, clock: Clock) -> None:
        self._handshake, self._clock, self._view, self._writer = handshake, clock, None, None
        self._loop = cast(asyncio.AbstractEventLoop, SimpleNamespace(call_soon=lambda do: None))


class OpcUaPort:
    """The nodes of one life."""

    def __init__(self, handshake: Handshake, clock: Clock) -> None:
        self._nodes = _Nodes(handshake, clock)

    def forget(self, line: Line) -> None:
        """The session is gone, which the server asks it."""

    def read(self, line: Line) -> Seen:
        self._nodes._forget()
        said = {path: self._nodes._answer(path).Value.Value for path in VARIABLES}
        own = {path.rpartition("/")[2]: value for path, value in said.items() if "CurrentState" not in path}
        state = said["VisionStateMachine/AutomaticModeStateMachine/CurrentState"]
        bits = {
            "ready": state == "Ready",
            "busy": state == "SingleExecution",
            "done": own["IsAvailable"],
            "pass": own["IsPass"],
            "not passed": own["IsNotPassed"],
        }
        word = own["ResultContent"]
        return [*(name for name, is_set in bits.items() if is_set), *({word} - {"", "pass"})], own["JobId"]

    def load(self, line: Line, number: int, piece: str, part: str) -> bool:
        return self.read(line) is not None

    def trigger(self, line: Line, number: int, piece: str, part: str) -> bool:
        return self._call(line, "StartSingleJob", number, piece, part)

    def acknowledge(self, line: Line) -> bool:
        return self._call(line, "Acknowledge")

    def lower(self, line: Line) -> None:
        """There is no level of a trigger."""

    def beat(self, line: Line, is_high: bool) -> bool:
        return self._call(line, "Beat")

    def _call(self, line: Line, method: str, *given: Any) -> bool:
        assert any(path.endswith(f"/{method}") for path in METHODS)
        _caller.set(line)
        try:
            self._nodes._call(method, *given).send(None)
        except StopIteration as ended:
            return bool(ended.value.is_good())
        raise AssertionError("a method waits")


PORTS = {"modbus": ModbusPort, "opcua": OpcUaPort}
