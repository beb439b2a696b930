"""Which protocol level the sink speaks: silence never leads to 3.1.1, where denied messages vanish without a word."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from scripted_broker import ScriptedBroker

from edge.core.errors import SinkUnavailable
from edge.core.ports import Message, ReportsFaults
from edge.messaging.mqtt_broker import Broker
from edge.messaging.mqtt_connection import Connection
from plugins.sinks.mqtt import MqttSink


@pytest.fixture
def sink(scripted: ScriptedBroker, stepped: Callable[..., MqttSink]) -> MqttSink:
    return stepped(scripted, Message("state", b"ready", retain=True), protocol="auto")


@contextmanager
def hurried(sink: MqttSink) -> Iterator[None]:
    """Inside, the sink waits 0.3 s for an answer: for a broker that gives none."""
    patient = sink._broker
    sink._broker = replace(patient, timeout_s=0.3)
    yield
    sink._broker = patient


def connected(sink: MqttSink) -> None:
    """Turn by turn until there is a connection: a slow machine may miss an answer in a hurry."""
    while sink.step() is not None:
        pass


def test_a_broker_that_hangs_while_5_is_tried_and_is_awake_for_3_1_1_is_spoken_to_at_5(
    scripted: ScriptedBroker, sink: MqttSink
) -> None:
    """The first CONNECT met a hanging broker; it answers at 3.1.1, so level 5 is asked again before that is chosen."""
    scripted.connects = ["silent"]

    assert sink.step() is None

    assert sink.level == "5"
    assert scripted.levels == ["5", "3.1.1", "5"]


@pytest.mark.parametrize("how", ["silent", "close"])
def test_a_sink_at_level_5_stays_in_silence(scripted: ScriptedBroker, sink: MqttSink, how: str) -> None:
    """However often the broker hangs or closes: level 5 or nothing."""
    assert sink.step() is None
    scripted.connects = [how] * 4
    scripted._sockets[-1].shutdown(2)
    with hurried(sink):
        while (pause_s := sink.step()) is None:
            pass
    for _ in range(3):
        with hurried(sink):
            pause_s = sink.step()
        assert pause_s is not None
        with pytest.raises(SinkUnavailable, match="does not answer at MQTT 5"):
            sink.send(Message("result", b""))

    assert sink.step() is None
    assert sink.level == "5"
    assert set(scripted.levels) == {"5"}


def test_a_broker_that_knows_only_3_1_1_is_used_and_asked_again_for_5(
    scripted: ScriptedBroker, sink: MqttSink, caplog: pytest.LogCaptureFixture
) -> None:
    """It does not answer at 5, twice, and answers at 3.1.1 in between, which the log says; when it is updated the sink
    returns to 5."""
    scripted.silent_at_5 = True
    with hurried(sink):
        connected(sink)
    assert sink.level == "3.1.1"
    assert "MQTT 3.1.1 is used" in caplog.text
    sink.find_level()
    connected(sink)
    assert sink.level == "3.1.1"

    scripted.silent_at_5 = False
    while sink.level == "3.1.1":
        sink.find_level()
        connected(sink)
    assert sink.level == "5"


def test_a_broker_that_says_it_does_not_know_5_is_believed(scripted: ScriptedBroker, sink: MqttSink) -> None:
    """And a station that had level 5 at this address reports the loss: denied messages would now vanish."""
    assert sink.step() is None
    assert isinstance(sink, ReportsFaults)
    assert list(sink.faults) == []
    scripted.connects = ["refuse", "refuse"]
    scripted._sockets[-1].shutdown(2)
    while sink.step() is None:
        pass

    assert sink.step() is None
    assert sink.level == "3.1.1"
    (fault,) = sink.faults
    assert "spoke MQTT 5 and now speaks only 3.1.1" in fault


def test_a_refused_login_shows_that_the_broker_speaks_5(scripted: ScriptedBroker) -> None:
    """The question comes with another client id, which access rules may refuse: that is an answer at level 5."""
    at = Broker("127.0.0.1", scripted.port, "level")
    while not Connection.speaks_5(at):  # it waits 2 s for an answer: too short for a very slow machine
        pass
    scripted.connects = ["refuse"]
    assert not Connection.speaks_5(at)


@pytest.mark.parametrize("level", ["5", "3.1.1"])
def test_messages_are_subscribed_to_at_qos_1(scripted: ScriptedBroker, level: str) -> None:
    """As docs/mqtt.md says of requests. The last byte of a SUBSCRIBE holds it in its two lowest bits."""
    connection = Connection.open(Broker("127.0.0.1", scripted.port, "level", level=level))
    connection.subscribe("cmd")
    connection.close()

    assert [body[-1] & 0b11 for body in scripted.subscriptions] == [1]


class RefusesLogins(ScriptedBroker):
    """It answers at either level that the password is wrong."""

    def _connect(self, one: socket.socket, level: str, body: bytes) -> None:
        self.levels.append(level)
        one.sendall(b"\x20\x03\x00\x86\x00" if level == "5" else b"\x20\x02\x00\x04")


def test_a_refused_login_at_level_5_is_an_answer_of_a_broker_that_speaks_it() -> None:
    with RefusesLogins() as broker, ScriptedBroker(connects=["refuse"]) as older:
        assert Connection.speaks_5(Broker("127.0.0.1", broker.port, "press2"))
        assert not Connection.speaks_5(Broker("127.0.0.1", older.port, "press2"))


def test_why_a_broker_ends_a_connection_is_said(scripted: ScriptedBroker) -> None:
    """DISCONNECT with the reason 0x8B of MQTT 5."""
    lost = threading.Event()
    connection = Connection.open(
        Broker("127.0.0.1", scripted.port, "press2", level="5", timeout_s=60.0), on_lost=lost.set
    )
    scripted._sockets[-1].sendall(b"\xe0\x02\x8b\x00")
    assert lost.wait(60)
    assert connection.why_lost == "Server shutting down"
    assert not connection.was_taken_over


def test_an_answer_names_the_request_that_it_is_of(scripted: ScriptedBroker) -> None:
    """The property Correlation Data, 9, with its length."""
    heard: list[bytes] = []
    take = scripted._take
    scripted._take = lambda one, level, kind, body: (heard.append(body), take(one, level, kind, body))[0]  # type: ignore[method-assign,assignment]
    connection = Connection.open(Broker("127.0.0.1", scripted.port, "press2", level="5", timeout_s=60.0))
    connection.publish(Message("answer", b"{}", correlation=b"id7"))
    connection.close()
    assert b"\x09\x00\x03id7" in heard[0]
