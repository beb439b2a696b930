"""The OPC UA server, asked by a client that is not ours (asyncua's)."""

import asyncio
import contextlib
import itertools
import re
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from handshake_bench import Bench, BenchHandshake
from opcua_plc import JOBS, RESULT, OpcUaPlc

from edge.clock import ManualClock
from edge.core.errors import ConfigError
from edge.core.handshake import Code, HandshakeView, Trigger
from plugins.handshakes import opcua
from plugins.handshakes.nodes import VARIABLES
from plugins.handshakes.opcua import OpcUaOptions, OpcUaServer


class Served:
    """A server on a bench, and its clients."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.server = OpcUaServer("127.0.0.1", 0, self.clock)
        self.begin()
        self.server.start(self)  # type: ignore[arg-type]  # it hands on to the present handshake
        self._clients: list[OpcUaPlc] = []

    def begin(self) -> None:
        """Begin with a new bench, for the server takes a second to start."""
        self.bench = Bench()
        self.handshake = BenchHandshake(self.bench)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.handshake, name)

    @property
    def address(self) -> str:
        return self.server.name.rpartition(" ")[2]

    def client(self, user: str | None = None) -> OpcUaPlc:
        self._clients.append(OpcUaPlc(self.address, user))
        return self._clients[-1]

    def forget_clients(self) -> None:
        while self._clients:
            with contextlib.suppress(Exception):
                self._clients.pop().close()

    def close(self) -> None:
        self.forget_clients()
        self.server.close()


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with contextlib.closing(Served()) as one:
        yield one


@pytest.fixture
def served(running: Served) -> Iterator[Served]:
    running.begin()
    yield running
    running.forget_clients()


@pytest.fixture
def plc(served: Served) -> OpcUaPlc:
    return served.client()


def test_a_job_from_its_start_to_the_next(served: Served, plc: OpcUaPlc) -> None:
    """The states of OPC 40100-1, and the result of the job."""
    seen = plc.read()
    assert seen["VisionStateMachine/CurrentState"] == "Operational"
    assert seen["AutomaticModeStateMachine/CurrentState"] == "Ready"
    assert plc.start_job(70_000, "piece 17", "") == "Good"
    assert served.handshake.taken == [Trigger(70_000, "piece 17", "")]
    seen = plc.read()
    assert seen["AutomaticModeStateMachine/CurrentState"] == "SingleExecution"
    assert (seen["JobId"], seen["PartId"], seen["IsAvailable"]) == (70_000, "piece 17", False)
    served.bench.press("pass")
    seen = plc.read()
    assert seen["AutomaticModeStateMachine/CurrentState"] == "Initialized"
    assert (seen["IsAvailable"], seen["IsPass"], seen["IsNotPassed"]) == (True, True, False)
    assert (seen["ResultContent"], seen["ResultId"], seen["ScoreRatio"]) == ("pass", "P1", 0.5)
    assert plc.acknowledge() == "Good"
    seen = plc.read()
    assert seen["AutomaticModeStateMachine/CurrentState"] == "Ready"
    assert (seen["JobId"], seen["IsPass"], seen["IsNotPassed"], seen["ResultContent"]) == (0, False, True, "")


@pytest.mark.parametrize(
    ("state", "word"),
    [("starting", "Preoperational"), ("halted", "Error"), ("stopped", "Halted"), ("ready", "Operational")],
)
def test_the_states_of_the_station(served: Served, plc: OpcUaPlc, state: Any, word: str) -> None:
    """A job that was passed is an error in all but Operational."""
    plc.start_job(1)
    served.bench.press("pass")
    served.bench.show(state, "gel", "device")
    seen = plc.read()
    assert seen["VisionStateMachine/CurrentState"] == word
    assert seen["Alarms"] == "device, gel"
    assert seen["IsPass"] is (word == "Operational")
    assert seen["ErrorCode"] == (0 if word == "Operational" else Code.HALTED)


@pytest.mark.parametrize(
    ("given", "status", "code"),
    [
        (lambda p, bench: (p.start_job(1), p.start_job(2)), "BadInvalidState", Code.BUSY),
        (
            lambda p, bench: (p.start_job(1), bench.press("fail"), p.start_job(2)),
            "BadInvalidState",
            Code.NOT_ACKNOWLEDGED,
        ),
        (
            lambda p, bench: (p.start_job(1), p.call(f"{JOBS}/Abort"), p.start_job(1)),
            "BadEntryExists",
            Code.ID_TWICE,
        ),
        (lambda p, bench: (bench.show("halted"), p.start_job(1)), "BadResourceUnavailable", Code.NOT_READY),
        (lambda p, bench: (p.start_job(0),), "BadInvalidArgument", Code.BAD_VALUE),
        (lambda p, bench: (p.start_job(1, "ä"),), "BadInvalidArgument", Code.BAD_VALUE),
    ],
)
def test_a_job_that_is_refused(
    served: Served, plc: OpcUaPlc, given: Callable[[OpcUaPlc, Bench], Any], status: str, code: Code
) -> None:
    assert given(plc, served.bench)[-1] == status
    assert plc.read()["RefusalCode"] == code


@pytest.mark.parametrize("arguments", [(), (1,), ("1", "", ""), (1, 2, 3), (None, None, None), (-1, "", "")])
def test_wrong_arguments_start_no_job(served: Served, plc: OpcUaPlc, arguments: tuple[Any, ...]) -> None:
    assert plc.call(f"{JOBS}/StartSingleJob", *arguments).startswith("Bad")
    assert served.handshake.taken == []
    seen = plc.read()
    assert (seen["AutomaticModeStateMachine/CurrentState"], seen["RefusalCode"]) == ("Ready", Code.BAD_VALUE)


@pytest.mark.parametrize("user", [None, "admin", "Admin"])
def test_no_node_can_be_written_or_removed(served: Served, user: str | None) -> None:
    """asyncua takes who says so for its administrator, without a password: he could write a pass."""
    from asyncua import ua

    plc = served.client(user)
    for path in VARIABLES:
        node = plc.node(path)
        with pytest.raises(ua.UaStatusCodeError):
            node.write_value(node.read_data_value().Value)
    with pytest.raises(ua.UaStatusCodeError):
        plc.client.delete_nodes([plc.node(RESULT)])
    with pytest.raises(ua.UaStatusCodeError):
        plc.node(RESULT).add_variable(ua.NodeId("more", plc.space), "more", True)


def test_a_second_plc_may_read_and_call_nothing(served: Served, plc: OpcUaPlc) -> None:
    """Until the first is not heard any more, or is gone."""
    plc.start_job(1)
    second = served.client()
    assert second.acknowledge() == "BadUserAccessDenied"
    assert second.beat() == "BadUserAccessDenied"
    assert re.match(
        r"a second client, 127\.0\.0\.1:\d+, calls a method while 127\.0\.0\.1:\d+ does; ",
        served.handshake.refused[-1][1],
    )
    assert second.read()["JobId"] == 1
    served.clock.sleep(opcua.WRITER_S)
    assert second.acknowledge() == "BadUserAccessDenied"
    served.clock.sleep(0.001)
    assert second.acknowledge() == "Good"
    assert plc.acknowledge() == "BadUserAccessDenied"
    second.close()
    assert plc.acknowledge() == "Good"


def test_cables_that_fell_silent_keep_no_plc_out(served: Served, plc: OpcUaPlc) -> None:
    """Nothing else ends them: the server sends nothing by itself. The one that asks is not the one that is ended."""
    for _ in range(opcua.MOST_CONNECTIONS + 2):
        served.client()
        assert plc.read()["IsNotPassed"] is True
    assert served.client().start_job(1) == "Good"
    assert plc.read()["JobId"] == 1


def test_requests_that_come_together_see_what_those_before_have_done(served: Served, plc: OpcUaPlc) -> None:
    """Else the pass of the job before is read after the next one has begun."""
    from asyncua import ua

    plc.start_job(1)
    served.bench.press("pass")

    async def ask() -> Any:
        async def read() -> Any:
            paths = ("JobId", "IsPass", "IsNotPassed")
            return await aio.read_values([aio.get_node(plc.node(f"{RESULT}/{one}").nodeid) for one in paths])

        async def call(path: str, *given: Any) -> None:
            above, method = (plc.node(one).nodeid for one in (path.rpartition("/")[0], path))
            await aio.get_node(above).call_method(aio.get_node(method), *given)

        aio, job = plc.client.aio_obj, ua.Variant(2, ua.VariantType.UInt32)
        acknowledge, start = call("ResultManagement/Acknowledge"), call(f"{JOBS}/StartSingleJob", job, "", "")
        return await asyncio.gather(read(), acknowledge, start, read())

    before, _, _, after = plc.client.tloop.post(ask())
    assert (before, after) == ([1, True, False], [2, False, True])


def test_one_request_reads_one_moment(served: Served, plc: OpcUaPlc, monkeypatch: pytest.MonkeyPatch) -> None:
    """While results come and go between any two looks at the station, no request sees half of one."""
    look, numbers = served.handshake.read, itertools.count(1)

    def press_and_look() -> HandshakeView:
        number = next(numbers)
        served.bench.machine.acknowledge(served.bench.now_ns)
        served.bench.trigger(number)
        served.bench.press("pass" if number % 2 else "fail", f"P{number}")
        return look()

    monkeypatch.setattr(served.handshake, "read", press_and_look)
    for one in [plc.read() for _ in range(20)]:
        assert (one["IsAvailable"], one["ResultId"]) == (True, f"P{one['JobId']}")
        assert one["ResultContent"] == ("pass" if one["JobId"] % 2 else "fail")
        assert one["IsPass"] is not one["IsNotPassed"]
        assert one["IsPass"] is (one["ResultContent"] == "pass")


def test_a_subscription_is_told(served: Served, plc: OpcUaPlc) -> None:
    """Of every change, the withdrawal of a pass too."""
    told, seen = [], threading.Condition()

    class Handler:
        def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
            with seen:
                told.append(value)
                seen.notify()

    def wait_for(value: bool) -> None:
        with seen:
            assert seen.wait_for(lambda: told[-1:] == [value], 10), told

    subscription = plc.client.create_subscription(20, Handler())
    subscription.subscribe_data_change(plc.node(f"{RESULT}/IsPass"))
    wait_for(False)
    plc.start_job(1)
    served.bench.press("pass")
    wait_for(True)
    served.bench.show("halted")
    wait_for(False)
    subscription.delete()


@pytest.mark.parametrize("step", range(4))
def test_the_connection_is_cut_at_every_step(served: Served, step: int) -> None:
    """What a PLC reads when it is back is of the id that it has given, and its next job has its own result."""
    plc = served.client()
    steps: list[Callable[[], Any]] = [
        lambda: plc.start_job(7),
        lambda: served.bench.press("pass"),
        plc.read,
        plc.acknowledge,
    ]
    for one in steps[:step]:
        one()
    plc.cut()
    back = served.client()
    seen = back.read()
    if seen["JobId"] == 7 and not seen["IsAvailable"]:
        served.bench.press("pass")
        seen = back.read()
    assert (seen["JobId"], seen["ResultContent"]) == ((7, "pass") if step else (0, ""))
    assert seen["IsPass"] is (step > 0)
    while back.acknowledge() == "BadUserAccessDenied":  # the server has yet to notice
        served.clock.sleep(1)
    assert back.start_job(8) == "Good"
    assert back.read()["IsPass"] is False
    served.bench.press("fail", "P8")
    seen = back.read()
    assert (seen["JobId"], seen["ResultId"], seen["ResultContent"]) == (8, "P8", "fail")


def test_a_thread_that_fails_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """The station says so: the PLC has lost its connection."""
    with contextlib.closing(Served()) as served:
        assert not served.server.has_ended

        async def fail(*given: object) -> None:
            raise RuntimeError("planted")

        monkeypatch.setattr(served.server, "_push", fail)
        served.server._thread.join()
        assert served.server.has_ended


def test_a_port_that_is_taken_and_a_missing_package_are_sentences(monkeypatch: pytest.MonkeyPatch) -> None:
    with contextlib.closing(OpcUaServer("127.0.0.1", 0, ManualClock())) as server:
        port = int(server.name.rpartition(":")[2])
        with pytest.raises(
            ConfigError, match=rf"127.0.0.1:{port} cannot be served \(Address already in use\)"
        ):
            opcua.plugin.open(OpcUaOptions(port=port), ManualClock())
    monkeypatch.setattr("edge.extras.is_installed", lambda package: package != "asyncua")
    with pytest.raises(
        ConfigError, match=r"needs asyncua, not installed here; pip install 'gelgate\[opcua\]'"
    ):
        opcua.plugin.open(OpcUaOptions(), ManualClock())
