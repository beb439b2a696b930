"""A message is set aside only when the broker says so; a broker that denies one topic still gets the others."""

from collections.abc import Callable
from dataclasses import replace
from unittest.mock import Mock

import pytest
from scripted_broker import ScriptedBroker

from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from plugins.sinks.mqtt import MqttSink
from plugins.sinks.mqtt_strikes import STRIKES

from .conftest import PATIENCE_S, ROOT

RESULT = Message("result", b"{}")
STATE = Message("state", b"ready", retain=True)
LAST = Message("last", b"{}", retain=True)
Stepped = Callable[..., MqttSink]


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


def test_silence_never_sets_a_message_aside(scripted: ScriptedBroker, stepped: Stepped) -> None:
    """The gateway gives up the connection itself; the message waits, and the silence is reported as such."""
    scripted.topics = {"result": "silent"}
    sink = stepped(scripted, STATE, acknowledge_s=0.3)

    assert outcomes(sink, 4) == [SinkUnavailable] * 4

    (fault,) = sink.faults
    assert "was silent 4 times on the one on result" in fault
    scripted.topics = {}
    sink._broker = replace(sink._broker, timeout_s=PATIENCE_S)
    assert outcomes(sink, 1) == []
    assert list(sink.faults) == []


@pytest.mark.parametrize("how", ["with the birth", "by a newer one"])
def test_silence_on_what_came_otherwise_is_over(how: str, scripted: ScriptedBroker, stepped: Stepped) -> None:
    """The message waits no more: the birth of the next connection has published it, or a newer one of its topic has
    taken its place. Else the fault would stay for ever."""
    sink = stepped(scripted, LAST if how == "with the birth" else STATE)
    for _ in range(STRIKES):
        sink._strikes.lost(LAST, Mock(was_given_up=True), SinkUnavailable("silent"))
    assert "was silent 3 times on the one on last" in next(iter(sink.faults))

    assert sink.step() is None
    sink.send(LAST if how == "with the birth" else replace(LAST, payload=b"newer"))
    assert list(sink.faults) == []


def test_a_broker_that_answers_no_ping_is_silent_too(
    scripted: ScriptedBroker, stepped: Stepped, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The library gives the connection up before the acknowledgement is due: that says nothing of the message."""
    monkeypatch.setattr("plugins.sinks.mqtt_strikes.STRIKES", 1)
    scripted.topics, scripted.answers_pings = {"result": "silent"}, False
    sink = stepped(scripted, STATE, keepalive_s=1)
    assert sink.step() is None

    with pytest.raises(SinkUnavailable, match="it was silent for longer than keepalive_s"):
        sink.send(RESULT)
    assert "was silent 1 times" in next(iter(sink.faults))


def test_three_closings_on_one_message_after_others_were_taken_are_its_refusal(
    scripted: ScriptedBroker,
    stepped: Stepped,
) -> None:
    """The birth of each connection is the proof that others are taken."""
    scripted.topics = {"result": "close"}
    sink = stepped(scripted, STATE)

    assert outcomes(sink, 3) == [SinkUnavailable, SinkUnavailable, SinkRejected]


def test_a_message_that_finds_the_connection_lost_is_no_reason(
    scripted: ScriptedBroker, stepped: Stepped
) -> None:
    """It was not sent. It is not refused, however often it is tried, and takes no proof from the one that was."""
    scripted.topics = {"result": "close"}
    sink = stepped(scripted, STATE)
    for _ in range(STRIKES - 1):
        assert outcomes(sink, 1) == [SinkUnavailable]
        for _ in range(STRIKES):
            with pytest.raises(SinkUnavailable):
                sink.send(LAST)

    assert outcomes(sink, 1) == [SinkRejected]


def test_closings_with_nothing_taken_are_no_refusal(scripted: ScriptedBroker, stepped: Stepped) -> None:
    """It may close on any message: a broker in trouble must not empty the queue into the refused rows."""
    scripted.topics = {"result": "close"}
    sink = stepped(scripted)

    assert outcomes(sink, 5) == [SinkUnavailable] * 5


def test_a_denied_retained_topic_stops_nothing_else(scripted: ScriptedBroker, stepped: Stepped) -> None:
    """`state` is forbidden by the broker's rules: `last` and results pass, and the fault is reported."""
    scripted.topics = {"state": "deny"}
    sink = stepped(scripted, STATE, LAST)

    assert sink.step() is None
    sink.send(RESULT)

    assert [topic.removeprefix(f"{ROOT}/") for topic, _ in scripted.published] == ["last", "result"]
    (fault,) = sink.faults
    assert "1 of the station's own messages are refused" in fault
    assert "state: Not authorized" in fault

    scripted.topics = {}
    sink.look_again()
    assert sink.faults == []
    assert scripted.published[-1] == (f"{ROOT}/state", STATE.payload)


def test_a_retained_topic_that_is_denied_later_is_reported_too(
    scripted: ScriptedBroker, stepped: Stepped
) -> None:
    """The broker's rules change during a connection: what it retains is not so any more. A result waits in the outbox,
    which has an alarm of its own."""
    sink, halted = stepped(scripted, STATE), replace(STATE, payload=b"halted")
    assert sink.step() is None

    scripted.topics = {"state": "deny", "result": "deny"}
    for message in (RESULT, halted):
        with pytest.raises(SinkRejected, match="Not authorized"):
            sink.send(message)
    (fault,) = sink.faults
    assert "1 of the station's own messages are refused" in fault
    assert "state: Not authorized" in fault

    scripted.topics = {}
    sink.send(halted)
    assert sink.faults == []


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_a_denied_subscription_to_commands_is_reported_and_results_pass(
    scripted: ScriptedBroker, stepped: Stepped, protocol: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Otherwise no one learns that requests never arrive. At 3.1.1 the one code of a refusal is 0x80."""
    scripted.topics = {"cmd": "deny"}
    station = Station(ROOT, "aside", on_command=lambda verb, payload: b"")
    sink = stepped(scripted, station=station, protocol=protocol)

    assert sink.step() is None
    sink.send(RESULT)

    (fault,) = sink.faults
    assert "no request can arrive" in fault
    sink.look_again()
    assert caplog.text.count("no request can arrive") == 1, "said once, and asked for again"

    scripted.topics = {}
    sink.look_again()
    assert sink.faults == []


def test_closings_while_nothing_waits_suggest_a_second_client_with_the_same_id(
    scripted: ScriptedBroker,
    stepped: Stepped,
) -> None:
    """A broker at 3.1.1 gives no reason when another client takes the id: three short connections are one."""
    sink = stepped(scripted, STATE, protocol="3.1.1")
    for _ in range(3):
        assert sink.step() is None
        scripted._sockets[-1].shutdown(2)
        sink._lost.wait(PATIENCE_S)
    sink.step()

    (fault,) = sink.faults
    assert "another client uses the client id 'press2'" in fault


def test_a_birth_that_breaks_once_keeps_no_sink_down(scripted: ScriptedBroker, stepped: Stepped) -> None:
    """An unexpected error in a function of the station: the connection is made again."""
    births = iter([RuntimeError("unexpected"), []])

    def birth() -> list[Message]:
        answer = next(births)
        if isinstance(answer, Exception):
            raise answer
        return answer

    sink = stepped(scripted, station=Station(ROOT, "unexpected", birth=birth))

    assert sink.step() is not None
    assert sink.step() is None
    sink.send(RESULT)
    assert next(births, None) is None
