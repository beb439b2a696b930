"""Requests over MQTT: bounded in size and number, each answered, and no answer outside the station's own topics."""

import json
import threading

import pytest
from scripted_broker import ScriptedBroker
from waiting import wait_until

from edge.core.errors import SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES, WAITING_REQUESTS
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from plugins.sinks.mqtt import MqttSink
from plugins.sinks.mqtt_options import LARGEST_PACKET_BYTES

from .conftest import PATIENCE_S, ROOT, SinkTo, sent

TRIGGER = f"{ROOT}/cmd/trigger"


class Asked:
    """The station's side: counts what is done and what is refused."""

    def __init__(self) -> None:
        self.done: list[bytes] = []
        self.refused: list[str] = []

    def command(self, verb: str, payload: bytes) -> bytes:
        self.done.append(payload)
        return b"done"

    def refusal(self, verb: str, payload: bytes, why: str) -> bytes:
        self.refused.append(why)
        return b"refused: " + why.encode()


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def sink(scripted: ScriptedBroker, asked: Asked, stepped: SinkTo) -> MqttSink:
    station = Station(ROOT, "asked", on_command=asked.command, on_refused=asked.refusal)
    opened = stepped(scripted, station=station)
    assert opened.step() is None
    return opened


@pytest.mark.parametrize(
    "topic",
    [
        "gelgate/site/line/OTHER/gel/v1/result",
        "gelgate/site/line/OTHER/gel/v1/cmd/replace_gel",
        f"{ROOT}/state",
        f"{ROOT}/cmd/trigger",
        f"{ROOT}/cmd/relearn/response",
        f"{TRIGGER}/responses",
        f"{TRIGGER}/response/#",
        f"{TRIGGER}/response/+/a",
    ],
)
def test_an_answer_never_leaves_the_station_s_own_topics(
    scripted: ScriptedBroker, sink: MqttSink, asked: Asked, topic: str
) -> None:
    """The request is refused, not done, and the refusal comes on the usual topic."""
    sink._received(Received(TRIGGER, b"{}", 1, False, response_topic=topic))

    wait_until(lambda: len(scripted.published) == 1)
    ((where, answer),) = scripted.published
    assert where == f"{TRIGGER}/response"
    assert b"its response topic is not" in answer
    assert asked.done == []


def test_an_answer_may_go_below_the_request_s_own_topic(scripted: ScriptedBroker, sink: MqttSink) -> None:
    """So that each asker can have its own."""
    sink.answer(Received(TRIGGER, b"{}", 1, False, response_topic=f"{TRIGGER}/response/line-7"))

    assert scripted.published == [(f"{TRIGGER}/response/line-7", b"done")]


def test_too_large_requests_are_unread(scripted: ScriptedBroker, sink: MqttSink, asked: Asked) -> None:
    """It is not kept either: 16 large ones would be the memory of the gateway."""
    scripted.send(TRIGGER, b"x" * (LARGEST_REQUEST_BYTES + 1))

    wait_until(lambda: len(scripted.published) == 1)
    assert b"a request has at most" in scripted.published[0][1]
    assert asked.done == []


def test_at_level_5_the_broker_is_told_the_largest_packet(sink: MqttSink, scripted: ScriptedBroker) -> None:
    """So that it does not send a larger one at all. Ref: MQTT 5.0, 3.1.2.11.4, property 0x27."""
    assert b"\x27" + LARGEST_PACKET_BYTES.to_bytes(4, "big") in scripted.properties[0]


def test_requests_that_find_no_room_are_answered(
    scripted: ScriptedBroker, sink: MqttSink, asked: Asked, caplog: pytest.LogCaptureFixture
) -> None:
    """A flood of which little is served: what fits waits, each of the others has its answer, and few have a line."""
    for number in range(WAITING_REQUESTS + 60):
        scripted.send(TRIGGER, b"%d" % number)
    wait_until(lambda: len(scripted.published) == 60)
    for number in range(1, 21):
        sink._requests.next()
        scripted.send(TRIGGER, b"%d" % number)
        scripted.send(TRIGGER, b"%d" % number)
        wait_until(lambda wanted=60 + number: len(scripted.published) == wanted)

    assert len(asked.refused) == 80
    assert sum("is refused" in line for line in caplog.messages) <= 12
    assert set(asked.refused) == {f"{WAITING_REQUESTS} requests are waiting; ask again later"}


def test_a_request_that_fails_where_it_arrives_ends_no_connection(
    scripted: ScriptedBroker, sink: MqttSink, caplog: pytest.LogCaptureFixture
) -> None:
    """One whose refusal has too long a topic, and one whose topic is no text. The next one is heard."""
    long = f"{ROOT}/cmd/{'x' * (65_530 - len(ROOT))}"
    scripted.send(long, bytes(LARGEST_REQUEST_BYTES + 1))
    scripted._sockets[-1].sendall(b"\x30\x05\x00\x02\xff\xfe\x00")
    scripted.send(TRIGGER, b"{}")

    wait_until(lambda: sink._requests._waiting.qsize() == 1)
    assert sum("failed here" in line for line in caplog.messages) == 2


def test_a_real_broker_does_not_deliver_a_huge_request(mosquitto: LocalBroker, sink_to: SinkTo) -> None:
    """One megabyte to a station that accepts 32 KiB: the broker keeps it, and the next request is served."""
    asked: list[int] = []
    is_served = threading.Event()

    def command(verb: str, payload: bytes) -> bytes:
        asked.append(len(payload))
        is_served.set()
        return b"{}"

    sink = sink_to(mosquitto, command, protocol="5")
    sent(sink, Message("result", b""))
    asker = Connection.open(Broker(mosquitto.host, mosquitto.port, "asker", level="5", timeout_s=PATIENCE_S))
    asker.publish(Message(TRIGGER, bytes(1_000_000)))
    asker.publish(Message(TRIGGER, json.dumps({"transaction": "1"}).encode()))
    assert is_served.wait(PATIENCE_S)
    asker.close()

    assert asked == [len(b'{"transaction": "1"}')]


def test_an_answer_that_nobody_waits_for_acknowledges_no_later_message(scripted: ScriptedBroker) -> None:
    """An id comes again after 65,535 messages; a message with that of a response waits for its own acknowledgement."""
    connection = Connection.open(Broker("127.0.0.1", scripted.port, "again", timeout_s=1.0))
    scripted.topics["late"] = "silent"
    connection.publish_soon(Message("soon", b"{}"))
    wait_until(lambda: len(scripted.published) == 1)
    connection._client._last_mid -= 1
    with pytest.raises(SinkUnavailable, match="did not acknowledge"):
        connection.publish(Message("late", b"{}"))
    connection.close()
