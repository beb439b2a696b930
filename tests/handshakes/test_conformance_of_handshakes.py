"""Every built-in server for a PLC passes the published checks, and each check notices what it is about."""

import threading
from collections.abc import Callable
from typing import Any

import pytest
from modbus_plc import ACKNOWLEDGE, TRIGGER, WATCHDOG, Plc
from opcua_plc import OpcUaPlc
from ports import free_port

from edge.clock import ManualClock
from edge.core.handshake import Code, Handshake, HandshakeServer, HandshakeView, Refusal, Trigger
from plugins.conformance import HANDSHAKE_CHECKS, check_handshake
from plugins.conformance.handshake import Seen
from plugins.handshakes import modbus, opcua


class ModbusClient:
    """pymodbus' client, as a `PlcClient`."""

    def __init__(self, port: int) -> None:
        self._plc = Plc(port)

    def trigger(self, trigger: Trigger) -> bool:
        words = self._plc.write_trigger(trigger.trigger_id, trigger.piece, trigger.part)
        return words and not (self._plc.write(TRIGGER, False) or self._plc.write(TRIGGER, True))

    def acknowledge(self) -> bool:
        return not (self._plc.write(ACKNOWLEDGE, False) or self._plc.write(ACKNOWLEDGE, True))

    def beat(self) -> None:
        for level in (False, True):
            self._plc.write(WATCHDOG, level)

    def read(self) -> Seen:
        bits, words = self._plc.bits, self._plc.words
        word = next((one for one in ("pass", "fail", "unsure", "rejected", "error") if one in bits), None)
        return Seen("ready" in bits, "busy" in bits, "done" in bits, word, words[1] << 16 | words[2])

    def close(self) -> None:
        self._plc.close()


class ModbusBench:
    """The server at a free port of this machine."""

    def __init__(self) -> None:
        self.port = free_port()

    def open(self) -> HandshakeServer:
        return modbus.plugin.open(modbus.ModbusOptions(port=self.port), ManualClock())

    def connect(self) -> ModbusClient:
        return ModbusClient(self.port)


class OpcUaClient:
    """asyncua's client, as a `PlcClient`."""

    def __init__(self, port: int) -> None:
        self._plc = OpcUaPlc(f"opc.tcp://127.0.0.1:{port}")

    def trigger(self, trigger: Trigger) -> bool:
        return self._plc.start_job(trigger.trigger_id, trigger.piece, trigger.part) == "Good"

    def acknowledge(self) -> bool:
        return self._plc.acknowledge() == "Good"

    def beat(self) -> None:
        self._plc.beat()

    def read(self) -> Seen:
        seen = self._plc.read()
        state = seen["AutomaticModeStateMachine/CurrentState"]
        word = seen["ResultContent"] or None
        return Seen(state == "Ready", state == "SingleExecution", seen["IsAvailable"], word, seen["JobId"])

    def close(self) -> None:
        self._plc.close()


class OpcUaBench:
    """The server at a free port of this machine."""

    def __init__(self) -> None:
        self.port = free_port()

    def open(self) -> HandshakeServer:
        return opcua.plugin.open(opcua.OpcUaOptions(port=self.port), ManualClock())

    def connect(self) -> OpcUaClient:
        return OpcUaClient(self.port)


@pytest.mark.parametrize("bench", [ModbusBench, OpcUaBench])
def test_every_built_in_server_passes(bench: Callable[[], Any]) -> None:
    """All checks. No thread of theirs is left that would keep a program from its end."""
    before = threading.enumerate()
    check_handshake(bench)
    assert [one for one in threading.enumerate() if not one.daemon and one not in before] == []


class _Wrong:
    """A `Handshake` between server and check that a mutation changes."""

    def __init__(self, inner: Handshake) -> None:
        self.inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


class Stale(_Wrong):
    """Shows for ever what it showed first."""

    first: HandshakeView | None = None

    def read(self) -> HandshakeView:
        self.first = self.first or self.inner.read()
        return self.first


class Twice(_Wrong):
    """Asks for each trigger twice."""

    def trigger(self, trigger: Trigger) -> Refusal | None:
        self.inner.trigger(trigger)
        return self.inner.trigger(trigger)


class Deaf(_Wrong):
    """Takes every trigger."""

    def trigger(self, trigger: Trigger) -> Refusal | None:
        self.inner.trigger(trigger)
        return None


class Dead(_Wrong):
    """Loses signs of life."""

    def beat(self) -> None:
        pass


class Sour(_Wrong):
    """Refuses every trigger."""

    def trigger(self, trigger: Trigger) -> Refusal | None:
        return Refusal(Code.BUSY, "no")


@pytest.mark.parametrize("wrong", [Stale, Twice, Deaf, Dead, Sour])
def test_a_wrong_server_is_noticed(wrong: type[_Wrong]) -> None:
    class Server:
        def __init__(self, inner: HandshakeServer) -> None:
            self.inner, self.name, self.close = inner, inner.name, inner.close
            self.has_ended = False

        def start(self, handshake: Handshake) -> None:
            self.inner.start(wrong(handshake))  # type: ignore[arg-type]

    made: list[Any] = []

    class Bench(ModbusBench):
        def open(self) -> Any:
            made.append(Server(super().open()))
            return made[-1]

        def connect(self) -> ModbusClient:
            made.append(super().connect())
            return made[-1]  # type: ignore[no-any-return]

    with pytest.raises(ExceptionGroup):
        check_handshake(Bench)
    for one in reversed(made):
        one.close()
    assert len(HANDSHAKE_CHECKS) == 7
