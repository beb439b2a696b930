"""The plain topic `availability`: what a dashboard reads of a station that comes, goes and disappears."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import pytest
from scripted_broker import ScriptedBroker

from edge.core.errors import SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker
from edge.messaging.mqtt_connection import Connection
from edge.messaging.status_payloads import availability_message
from plugins.sinks.mqtt import MqttSink

from .conftest import PATIENCE_S, ROOT, Listen, Listener, SinkTo, seldom_amqtt

STATION = Station(
    ROOT,
    "press2",
    offline=availability_message(is_online=False),
    birth=lambda: [availability_message(is_online=True)],
)


@pytest.fixture
def stepped_sink(mosquitto: LocalBroker, stepped: SinkTo) -> MqttSink:
    """Such a sink without threads, connected: what happens comes of the turns that a test takes."""
    sink = stepped(mosquitto, station=STATION)
    assert sink.step() is None
    return sink


def says(*words: bytes) -> Callable[[Listener], bool]:
    """One after the other, whatever came before or has come since."""

    def are_said(listener: Listener) -> bool:
        said = listener.payloads("availability")
        return any(said[at : at + len(words)] == list(words) for at in range(len(said)))

    return are_said


def take_its_client_id(broker: LocalBroker) -> None:
    """Connects as the second connection does; the station may take the id back before this one is established."""
    thief = Broker(broker.host, broker.port, "press2-availability", level="5", timeout_s=PATIENCE_S)
    with suppress(SinkUnavailable):
        Connection.open(thief).close()


def lose_the_second_connection(broker: LocalBroker, sink: MqttSink) -> None:
    """Of a sink without threads, which sees it in the next turn."""
    take_its_client_id(broker)
    assert sink._lost.wait(PATIENCE_S)
    assert sink.step() is None


@seldom_amqtt
def test_a_station_that_disappears_is_offline(
    any_broker: tuple[LocalBroker, str], sink_to: SinkTo, listen: Listen
) -> None:
    """The broker says so when both connections end without a word; back again, it is online, and that is retained."""
    broker, protocol = any_broker
    listener = listen(broker)
    sink = sink_to(broker, station=STATION, protocol=protocol)
    listener.wait_for(says(b"online"))
    sink.send(Message("result", b"{}"))  # returns when the connection is in use

    assert sink._connection is not None
    sink._connection.abandon("the cable is pulled")

    listener.wait_for(says(b"online", b"offline", b"online"))
    late = listen(broker, client_id="late")
    late.wait_for(says(b"online"))
    assert late.heard[0].retain


def test_a_second_connection_that_is_lost_alone_is_opened_again(
    mosquitto: LocalBroker, stepped_sink: MqttSink, listen: Listen
) -> None:
    """Another client takes its id: offline for a moment, online in the next turn; the first connection stays."""
    listener = listen(mosquitto)
    listener.wait_for(says(b"online"))
    first = stepped_sink._connection

    lose_the_second_connection(mosquitto, stepped_sink)

    listener.wait_for(says(b"offline", b"online"))
    assert stepped_sink._connection is first


@pytest.mark.parametrize("is_told", [True, False])
def test_a_station_that_ends_is_offline(
    mosquitto: LocalBroker, sink_to: SinkTo, listen: Listen, is_told: bool
) -> None:
    """What it has said last stays, and no will comes; where its end was not said, the broker says the wills."""
    listener, lost = listen(mosquitto), Message("state", b"lost", 1, retain=True)
    sink = sink_to(mosquitto, station=replace(STATION, will=lost))
    listener.wait_for(says(b"online"))
    if is_told:
        sink.send(availability_message(is_online=False))
        sink.send(Message("state", b"stopped", 1, retain=True))

    sink.close()
    listener.ask("marker", b"")  # comes after anything that the broker would have published

    listener.wait_for(lambda heard: heard.payloads("cmd/marker") != [])
    listener.wait_for(says(b"online", b"offline"))
    assert listener.payloads("availability") == [b"online", b"offline"]
    assert listener.payloads("state") == [b"stopped" if is_told else b"lost"]
    assert not sink._availability.is_held


def test_without_it_the_topic_is_empty(mosquitto: LocalBroker, sink_to: SinkTo, listen: Listen) -> None:
    """With the option off nothing says online: no one could say offline later."""
    listener = listen(mosquitto)

    sink = sink_to(mosquitto, station=STATION, availability=False)

    listener.wait_for(lambda heard: heard.payloads("availability") == [b""])
    assert list(sink.faults) == []


def test_a_broker_that_refuses_the_second_connection_is_a_fault(sink_to: SinkTo) -> None:
    """The rest works, the topic is empty, and the sentence names the client id and the option."""
    with ScriptedBroker(connects=["accept", "refuse"]) as broker:
        sink = sink_to(broker, station=STATION, protocol="5")

        sink.send(Message("result", b"{}"))

        assert broker.published[:2] == [(f"{ROOT}/availability", b""), (f"{ROOT}/result", b"{}")]
        assert [name in str(sink.faults) for name in ("press2-availability", "availability = false")] == [
            True
        ] * 2
        sink.close()


def test_a_second_connection_that_never_lasts_is_given_up(
    mosquitto: LocalBroker, stepped_sink: MqttSink, listen: Listen
) -> None:
    """Two stations with one client id do not fight for ever: after some short ones it is a fault, tried again later."""
    listener = listen(mosquitto)
    listener.wait_for(says(b"online"))

    deadline = time.monotonic() + PATIENCE_S
    while not stepped_sink.faults and time.monotonic() < deadline:
        lose_the_second_connection(mosquitto, stepped_sink)

    listener.wait_for(says(b""))
    assert "is not kept" in str(stepped_sink.faults)

    stepped_sink.find_availability()  # the turn that comes after some time

    listener.wait_for(says(b"", b"online"))
    assert list(stepped_sink.faults) == []
