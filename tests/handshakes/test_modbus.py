"""The Modbus TCP server, asked by a client that is not ours (pymodbus), and byte by byte over a socket."""

import contextlib
import socket
import struct
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from handshake_bench import Bench, BenchHandshake
from modbus_plc import ACKNOWLEDGE, HELD, TRIGGER, WATCHDOG, Plc
from ports import free_port
from pymodbus.client import ModbusTcpClient

from edge.clock import ManualClock
from edge.core.errors import ConfigError
from edge.core.handshake import Code, Trigger
from edge.messaging.alarm_payload import ALARMS
from plugins.handshakes.modbus import (
    LINES_PER_MINUTE,
    MOST_CONNECTIONS,
    WRITER_S,
    ModbusOptions,
    ModbusServer,
    plugin,
)
from plugins.handshakes.registers import ALARM_BITS, COILS, HOLDING, INPUTS, STATUS_BITS

STATUS, ID, ERROR, REFUSAL, RATIO, GEL, ALARM_WORD = 0, 1, 3, 4, 5, 6, 7


class Served:
    """A server on a bench, and its clients."""

    def __init__(self, **bench: Any) -> None:
        self.bench = Bench(**bench)
        self.handshake, self.clock = BenchHandshake(self.bench), ManualClock()
        self.server = ModbusServer("127.0.0.1", 0, self.clock)
        self.port = int(self.server.name.rpartition(":")[2])
        self.server.start(self.handshake)
        self._clients: list[Any] = []

    def client(self) -> "Plc":
        plc = Plc(self.port)
        self._clients.append(plc)
        return plc

    def close(self) -> None:
        for client in self._clients:
            client.close()
        self.server.close()


@pytest.fixture
def served() -> Iterator[Served]:
    with contextlib.closing(Served()) as one:
        yield one


def test_a_handshake_as_a_plc_programmer_knows_it(served: Served) -> None:
    """Id, trigger, busy, done with its bits, acknowledge, trigger down, ready."""
    plc = served.client()
    assert plc.bits == {"ready", "not passed"}
    assert plc.words[RATIO] == 65535
    assert plc.trigger(70_000, "piece 17", "") == 0
    assert served.handshake.taken == [Trigger(70_000, "piece 17", "")]
    assert plc.bits == {"busy", "not passed"}
    assert plc.words[ID : ID + 2] == [1, 70_000 - 65_536]
    served.bench.press("pass")
    assert plc.bits == {"done", "pass"}
    assert plc.words[ID : GEL + 1] == [1, 70_000 - 65_536, 0, 0, 500, 42]
    assert plc.write(ACKNOWLEDGE, True) == 0
    assert plc.bits == {"ready", "not passed"}
    assert plc.words[ID : ID + 2] == [0, 0]
    assert plc.write(TRIGGER, False) == 0


def test_coils_are_levels_that_may_be_written_all_the_time(served: Served) -> None:
    """As an I/O scanner does: only a change from 0 to 1 is a trigger or an acknowledgement."""
    plc = served.client()
    plc.write_trigger(1)
    for levels in ([0, 0, 0], [1, 0, 0], [1, 0, 1], [1, 0, 0]):
        assert not plc.client.write_coils(0, [bool(level) for level in levels]).isError()
    assert len(served.handshake.taken) == 1
    served.bench.press("pass")
    for levels in ([1, 0, 1], [1, 1, 0], [1, 1, 1], [0, 0, 0]):
        assert not plc.client.write_coils(0, [bool(level) for level in levels]).isError()
    assert plc.bits == {"ready", "not passed"}
    assert len(served.handshake.taken) == 1
    assert plc.client.read_coils(0, count=3).bits[:3] == [False] * 3


def test_the_watchdog_lives_by_changes() -> None:
    """A coil that is written and stays as it is is none."""
    with contextlib.closing(Served(watchdog_s=1)) as served:
        plc = served.client()
        assert plc.trigger(1) == 4, "no sign of life yet"
        for level in (False, True):
            plc.write(WATCHDOG, level)
        assert plc.write(TRIGGER, True) == 0
        served.bench.press("pass")
        for _ in range(3):
            plc.write(WATCHDOG, True)
            served.bench.wait(0.4)
        assert "pass" not in plc.bits
        assert plc.words[ERROR] == Code.NO_BEAT


def test_alarms_have_their_bits(served: Served) -> None:
    """An alarm of another package is in the last one."""
    served.bench.show("ready", "device", "gel", "acme")
    plc = served.client()
    assert plc.words[ALARM_WORD] == 1 << 0 | 1 << 6 | 1 << 15
    assert "alarm" in plc.bits
    named = [alarm for alarms in ALARM_BITS for alarm in alarms]
    assert len(ALARM_BITS) == 15
    assert len(set(named)) == len(named)
    assert set(named) <= set(ALARMS)


@pytest.mark.parametrize(
    ("given", "exception", "code"),
    [
        (lambda plc, bench: (plc.trigger(1), plc.trigger(2)), 6, Code.BUSY),
        (lambda plc, bench: (plc.trigger(1), bench.press("pass"), plc.trigger(2)), 6, Code.NOT_ACKNOWLEDGED),
        (lambda plc, bench: (plc.trigger(1), plc.write(ACKNOWLEDGE, True), plc.trigger(1)), 3, Code.ID_TWICE),
        (lambda plc, bench: (bench.show("halted"), plc.trigger(1)), 4, Code.NOT_READY),
        (lambda plc, bench: (plc.trigger(0),), 3, Code.BAD_VALUE),
        (lambda plc, bench: (plc.trigger(1, "ä"),), 3, Code.BAD_VALUE),
    ],
)
def test_a_trigger_that_is_refused(
    served: Served, given: Callable[[Plc, Bench], Any], exception: int, code: Code
) -> None:
    plc = served.client()
    assert given(plc, served.bench)[-1] == exception
    assert plc.words[REFUSAL] == code


def test_a_trigger_that_is_high_from_the_beginning_is_refused(served: Served) -> None:
    """A PLC that still waits for a station of before a restart: its id would be answered by a later press."""
    plc = served.client()
    plc.write_trigger(1)
    assert plc.write(TRIGGER, True) == 3
    assert "is 1 from the beginning" in served.handshake.refused[-1][1]
    assert plc.words[REFUSAL] == Code.BAD_VALUE
    assert plc.write(TRIGGER, True) == 3
    assert plc.write(TRIGGER, False) == 0
    assert plc.write(TRIGGER, True) == 0


ASKED: dict[str, tuple[Callable[[ModbusTcpClient], Any], int, str]] = {
    "an input beyond the map": (lambda c: c.read_discrete_inputs(0, count=64), 2, "discrete inputs 0 to 63"),
    "a register beyond the map": (
        lambda c: c.read_input_registers(HELD),
        2,
        "input registers 10 to 10, where",
    ),
    "a coil beyond the map": (lambda c: c.write_coil(3, True), 2, "coils 3 to 3, where"),
    "text beyond the map": (lambda c: c.write_registers(30, [0] * 20), 2, "holding registers 30 to 49"),
    "too many": (lambda c: c.read_holding_registers(0, count=125), 2, "holding registers 0 to 124"),
    "another function": (lambda c: c.read_exception_status(), 1, "function 7 of 127.0.0.1 is not served"),
}


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_what_the_map_does_not_have_is_an_exception(
    served: Served, asked: tuple[Callable[[ModbusTcpClient], Any], int, str]
) -> None:
    """With a sentence for the ledger. The connection lives on."""
    plc, (ask, code, sentence) = served.client(), asked
    answer = ask(plc.client)
    assert answer.isError()
    assert answer.exception_code == code
    assert sentence in served.handshake.refused[-1][1]
    assert "ready" in plc.bits


def exchange(connection: socket.socket, *requests: bytes) -> list[bytes]:
    """Send them in one segment; return what is answered to each, without the header."""
    frames = (struct.pack(">HHHB", n, 0, len(one) + 1, 1) + one for n, one in enumerate(requests))
    connection.sendall(b"".join(frames))
    answers = []
    for n in range(len(requests)):
        transaction, _, length, _ = struct.unpack(">HHHB", receive(connection, 7))
        assert transaction == n
        answers.append(receive(connection, length - 1))
    return answers


def receive(connection: socket.socket, size: int) -> bytes:
    received = b""
    while len(received) < size:
        more = connection.recv(size - len(received))
        assert more, "the connection was ended"
        received += more
    return received


@pytest.fixture
def connection(served: Served) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", served.port), 5) as one:
        yield one


def test_requests_that_come_together_are_answered_in_order(connection: socket.socket) -> None:
    """Three in one segment; a trigger between two reads is not lost."""
    read, id_1 = b"\x02\0\0\0\x03", b"\x10\0\0\0\x02\x04\0\0\0\x01"
    answers = exchange(connection, id_1, b"\x05\0\0\0\0", read, b"\x05\0\0\xff\0", read)
    assert answers == [id_1[:5], b"\x05\0\0\0\0", b"\x02\x01\x01", b"\x05\0\0\xff\0", b"\x02\x01\x02"]


@pytest.mark.parametrize(
    "request_",
    [b"\x05\0\0\x12\x34", b"\x0f\0\0\0\x03\x02\0\0", b"\x10\0\0\0\x02\x02\0\0", b"\x02\0\0", b"\x02\0\0\0\0"],
)
def test_a_request_that_is_wrong_in_itself_is_an_illegal_value(
    connection: socket.socket, served: Served, request_: bytes
) -> None:
    """Nothing is written, and the next one is answered."""
    answers = exchange(connection, request_, b"\x01\0\0\0\x03")
    assert answers == [bytes([request_[0] | 0x80, 3]), b"\x01\x01\x00"]
    assert len(served.handshake.refused) == 1


@pytest.mark.parametrize("sent", [b"GET / HTTP/1.1\r\n", b"\0\0\0\0\xff\xff\x01", b"\0\0\0\0\0\x01\x01"])
def test_no_modbus_ends_the_connection(connection: socket.socket, served: Served, sent: bytes) -> None:
    """And no other one."""
    connection.sendall(sent)
    with contextlib.suppress(ConnectionResetError):
        assert connection.recv(1) == b""
    assert "ready" in served.client().bits


def test_a_second_plc_may_read_and_not_write(served: Served) -> None:
    """Until the first one is gone, or has asked nothing for a while: a pulled cable says no farewell."""
    first, second = served.client(), served.client()
    assert first.trigger(1) == 0
    for ask in (lambda: second.write(ACKNOWLEDGE, True), lambda: second.write(TRIGGER, False)):
        assert ask() == 6
    assert "a second client, at 127.0.0.1, writes" in served.handshake.refused[-1][1]
    assert second.client.write_register(1, 9).exception_code == 6
    assert "busy" in second.bits
    served.clock.sleep(WRITER_S - 0.1)
    assert "busy" in first.bits
    served.clock.sleep(WRITER_S - 0.1)
    assert second.write(ACKNOWLEDGE, True) == 6, "the first has asked since"
    served.clock.sleep(0.2)
    assert second.write(ACKNOWLEDGE, True) == 0
    assert first.write(ACKNOWLEDGE, False) == 6
    second.close()
    assert first.write(ACKNOWLEDGE, False) == 0


def test_a_client_at_another_address_finds_no_trigger_of_the_one_before(served: Served) -> None:
    """Its own id has to be written, and its trigger seen as 0."""
    first = served.client()
    first.write_trigger(5, "piece")
    first.write(TRIGGER, False)
    first.close()
    other = socket.create_connection(("127.0.0.1", served.port), 5, source_address=("127.0.0.2", 0))
    with other:
        assert exchange(other, b"\x05\0\0\xff\0") == [b"\x85\x03"]
        assert exchange(other, b"\x05\0\0\0\0", b"\x05\0\0\xff\0") == [b"\x05\0\0\0\0", b"\x85\x03"]
        assert exchange(other, b"\x03\0\0\0\x02") == [b"\x03\x04\0\0\0\0"]
    assert served.handshake.taken == []


def test_cables_that_fell_silent_keep_no_plc_out(served: Served) -> None:
    """Something between may answer for a PLC that is gone. The one that asks is not the one that is ended."""
    first, silent = served.client(), []
    for _ in range(MOST_CONNECTIONS + 8):
        silent.append(served.client())
        assert silent[-1].bits == {"ready", "not passed"}
        assert first.bits == {"ready", "not passed"}
    assert served.client().trigger(1) == 0
    assert silent[0].client.socket.recv(1) == b"", "the one that was silent longest"


def test_connecting_again_and_again_fills_no_log(served: Served, caplog: pytest.LogCaptureFixture) -> None:
    """A health check that speaks HTTP, every second of the year."""
    for _ in range(LINES_PER_MINUTE + 4):
        with socket.create_connection(("127.0.0.1", served.port), 5) as stranger:
            stranger.sendall(b"GET / HTTP/1.1\r\n\r\n")
            while stranger.recv(100):
                pass
    said = [one.getMessage() for one in caplog.records if "is no Modbus TCP" in one.getMessage()]
    assert len(said) == LINES_PER_MINUTE


class CutPlc:
    """A PLC whose cable is pulled at one step: before the request, in its middle, before its answer, or after it."""

    def __init__(self, served: Served, step: int, how: str) -> None:
        self.served, self.step, self.how, self.number = served, step, how, -1
        self.connection = socket.create_connection(("127.0.0.1", served.port), 5)

    def ask(self, request: bytes) -> None:
        self.number += 1
        frame = struct.pack(">HHHB", 1, 0, len(request) + 1, 1) + request
        if self.number != self.step:
            exchange(self.connection, request)
            return
        if self.how != "before":
            self.connection.sendall(frame[: 9 if self.how == "middle" else None])
        if self.how == "after":
            receive(self.connection, 8)
        self.connection.shutdown(socket.SHUT_WR)
        while self.connection.recv(64):  # until the server is done with it
            pass
        self.connection.close()
        raise ConnectionError


@pytest.mark.parametrize("how", ["before", "middle", "unanswered", "after"])
@pytest.mark.parametrize("step", range(6))
def test_the_cable_is_pulled_at_every_step(served: Served, step: int, how: str) -> None:
    """Never a pass of another id, never a stale bit: what a PLC reads afterwards is of the id that it has given."""
    plc, recorded = CutPlc(served, step, how), False
    with contextlib.suppress(ConnectionError):
        plc.ask(b"\x10\0\0\0\x02\x04\0\0\0\x07")
        plc.ask(b"\x05\0\0\0\0")
        plc.ask(b"\x05\0\0\xff\0")
        served.bench.press("pass")
        recorded = True
        plc.ask(b"\x02\0\0\0\x0a")
        plc.ask(b"\x05\0\x01\xff\0")
        plc.ask(b"\x05\0\0\0\0")
    back = served.client()
    seen = back.words
    if seen[ID + 1] == 7:
        if not recorded and "busy" in back.bits:  # the press comes while nobody is there
            served.bench.press("pass")
        assert back.bits == {"done", "pass"}
    else:
        assert seen[ID : ID + 2] == [0, 0]
        assert back.bits == {"ready", "not passed"}
    for coil in (ACKNOWLEDGE, TRIGGER):
        back.write(coil, False)
    back.write(ACKNOWLEDGE, True)
    back.write(ACKNOWLEDGE, False)
    assert back.trigger(8) == 0
    assert back.bits == {"busy", "not passed"}
    served.bench.press("fail", "P8")
    assert back.words[ID : ID + 2] == [0, 8]
    assert back.bits == {"done", "fail", "not passed"}


def test_a_port_that_is_taken_is_a_sentence() -> None:
    with contextlib.closing(ModbusServer("127.0.0.1", free_port(), ManualClock())) as server:
        port = int(server.name.rpartition(":")[2])
        with pytest.raises(
            ConfigError, match=rf"127.0.0.1:{port} cannot be served \(Address already in use\)"
        ):
            plugin.open(ModbusOptions(port=port), ManualClock())
    with pytest.raises(ConfigError, match=r"192\.0\.2\.1:1502 cannot be served"):
        plugin.open(ModbusOptions(host="192.0.2.1"), ManualClock())


def test_no_two_values_share_an_address() -> None:
    """The map is fixed: a new value gets a place behind the others, and the map another version."""
    assert [name for name, _ in COILS] == ["trigger", "acknowledge", "watchdog"]
    assert [name for name, _, _ in STATUS_BITS[:9]] == [
        "ready", "busy", "done", "pass", "fail", "unsure", "rejected", "error", "not passed",
    ]  # fmt: skip
    assert len(STATUS_BITS) <= 16
    starts = {register.name: sum(one.count for one in INPUTS[:n]) for n, register in enumerate(INPUTS)}
    assert [starts[name] for name in ("status word", "id", "error code", "refusal code", "score ratio")] == [
        STATUS, ID, ERROR, REFUSAL, RATIO,
    ]  # fmt: skip
    assert starts["gel life"] == GEL
    assert starts["alarm word"] == ALARM_WORD
    assert [count for count, _ in HOLDING.values()] == [2, 16, 16]
