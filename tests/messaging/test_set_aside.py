"""A message is set aside only when the broker says so; a broker that denies one topic still gets the others."""

import random
from collections.abc import Iterator
from dataclasses import replace

import pytest
from scripted_broker import ScriptedBroker

from edge.core.backoff import Backoff
from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from plugins.sinks.mqtt import MqttSink
from plugins.sinks.mqtt_options import MqttOptions

from .conftest import PATIENCE_S, ROOT

RESULT = Message("result", b"{}")
STATE = Message("state", b"ready", retain=True)
LAST = Message("last", b"{}", retain=True)


@pytest.fixture
def broker() -> Iterator[ScriptedBroker]:
    with ScriptedBroker() as scripted:
        yield scripted


def stepped(
    broker: ScriptedBroker,
    *birth: Message,
    protocol: str = "5",
    limit_s: float = PATIENCE_S,
    **station: object,
) -> MqttSink:
    """limit_s: the longest wait for an answer."""
    options = MqttOptions.model_validate(
        {"host": "127.0.0.1", "port": broker.port, "acknowledge_s": limit_s, "protocol": protocol}
    )
    context = Station(ROOT, "aside", birth=lambda: birth, **station)  # type: ignore[arg-type]
    return MqttSink(options.broker("aside"), context, Backoff(random.Random(0), 0.2, 1.0))


def outcomes(sink: MqttSink, times: int) -> list[type[Exception]]:
    """Of that number of attempts, each on a connection that works."""
    found: list[type[Exception]] = []
    for _ in range(times):
        while sink.step() is not None or sink._lost.is_set():
            pass
        try:
            sink.send(RESULT)
        except (SinkRejected, SinkUnavailable) as error:
            found.append(type(error))
    return found


def test_silence_never_sets_a_message_aside(broker: ScriptedBroker) -> None:
    """The gateway gives up the connection itself; the message waits, and the silence is reported as such."""
    broker.topics = {"result": "silent"}
    sink = stepped(broker, STATE, limit_s=0.3)

    assert outcomes(sink, 4) == [SinkUnavailable] * 4

    (fault,) = sink.faults
    assert "was silent 4 times on the one on result" in fault
    broker.topics = {}
    sink._broker = replace(sink._broker, timeout_s=PATIENCE_S)
    assert outcomes(sink, 1) == []
    assert list(sink.faults) == []
    sink.close()


def test_three_closings_on_one_message_after_others_were_taken_are_its_refusal(
    broker: ScriptedBroker,
) -> None:
    """The birth of each connection is the proof that others are taken."""
    broker.topics = {"result": "close"}
    sink = stepped(broker, STATE)

    assert outcomes(sink, 3) == [SinkUnavailable, SinkUnavailable, SinkRejected]
    sink.close()


def test_closings_by_a_broker_that_has_taken_nothing_are_no_refusal(broker: ScriptedBroker) -> None:
    """It may close on any message: a broker in trouble must not empty the queue into the refused rows."""
    broker.topics = {"result": "close"}
    sink = stepped(broker)

    assert outcomes(sink, 5) == [SinkUnavailable] * 5
    sink.close()


def test_a_denied_retained_topic_stops_nothing_else(broker: ScriptedBroker) -> None:
    """`state` is forbidden by the broker's rules: `last` and results pass, and the fault is reported."""
    broker.topics = {"state": "deny"}
    sink = stepped(broker, STATE, LAST)

    assert sink.step() is None
    sink.send(RESULT)

    assert [topic.removeprefix(f"{ROOT}/") for topic, _ in broker.published] == ["last", "result"]
    (fault,) = sink.faults
    assert "1 of the station's own messages are refused" in fault
    assert "state: Not authorized" in fault
    sink.close()


def test_a_denied_subscription_to_commands_is_reported_and_results_pass(broker: ScriptedBroker) -> None:
    """Otherwise no one learns that requests never arrive."""
    broker.topics = {"cmd": "deny"}
    sink = stepped(broker, STATE, on_command=lambda verb, payload: b"")

    assert sink.step() is None
    sink.send(RESULT)

    (fault,) = sink.faults
    assert "no request can arrive" in fault
    sink.close()


def test_closings_while_nothing_waits_suggest_a_second_client_with_the_same_id(
    broker: ScriptedBroker,
) -> None:
    """A broker at 3.1.1 gives no reason when another client takes the id: three short connections are one."""
    sink = stepped(broker, STATE, protocol="3.1.1")
    for _ in range(3):
        assert sink.step() is None
        broker._sockets[-1].shutdown(2)
        sink._lost.wait(PATIENCE_S)
    sink.step()

    (fault,) = sink.faults
    assert "another client uses the client id 'aside'" in fault
    sink.close()
