"""Which protocol level the sink speaks: silence never leads to 3.1.1, where denied messages vanish without a word."""

import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from scripted_broker import ScriptedBroker

from edge.core.backoff import Backoff
from edge.core.errors import SinkUnavailable
from edge.core.ports import Message, ReportsFaults
from edge.core.sink_context import Station
from edge.messaging.mqtt_broker import Broker
from edge.messaging.mqtt_connection import Connection
from plugins.sinks.mqtt import MqttSink
from plugins.sinks.mqtt_options import MqttOptions

from .conftest import PATIENCE_S, ROOT


@pytest.fixture
def broker() -> Iterator[ScriptedBroker]:
    with ScriptedBroker() as scripted:
        yield scripted


@pytest.fixture
def sink(broker: ScriptedBroker) -> Iterator[MqttSink]:
    """Without threads: a test takes each turn."""
    options = MqttOptions(host="127.0.0.1", port=broker.port, acknowledge_s=PATIENCE_S)
    station = Station(ROOT, "level", birth=lambda: [Message("state", b"ready", retain=True)])
    stepped = MqttSink(options.broker("level"), station, Backoff(random.Random(0), 0.2, 1.0))
    yield stepped
    stepped.close()


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
    broker: ScriptedBroker, sink: MqttSink
) -> None:
    """The first CONNECT met a hanging broker; it answers at 3.1.1, so level 5 is asked again before that is chosen."""
    broker.connects = ["silent"]

    assert sink.step() is None

    assert sink.level == "5"
    assert broker.levels == ["5", "3.1.1", "5"]


@pytest.mark.parametrize("how", ["silent", "close"])
def test_a_sink_that_had_level_5_never_falls_on_silence(
    broker: ScriptedBroker, sink: MqttSink, how: str
) -> None:
    """However often the broker hangs or closes: level 5 or nothing."""
    assert sink.step() is None
    broker.connects = [how] * 4
    broker._sockets[-1].shutdown(2)
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
    assert set(broker.levels) == {"5"}


def test_a_broker_that_knows_only_3_1_1_is_used_and_asked_again_for_5(
    broker: ScriptedBroker, sink: MqttSink
) -> None:
    """It does not answer at 5, twice, and answers at 3.1.1 in between; when it is updated the sink returns to 5."""
    broker.silent_at_5 = True
    with hurried(sink):
        connected(sink)
    assert sink.level == "3.1.1"
    sink.find_level()
    connected(sink)
    assert sink.level == "3.1.1"

    broker.silent_at_5 = False
    while sink.level == "3.1.1":
        sink.find_level()
        connected(sink)
    assert sink.level == "5"


def test_a_broker_that_says_that_it_does_not_know_5_is_believed(
    broker: ScriptedBroker, sink: MqttSink
) -> None:
    """And a station that had level 5 at this address reports the loss: denied messages would now vanish."""
    assert sink.step() is None
    assert isinstance(sink, ReportsFaults)
    assert list(sink.faults) == []
    broker.connects = ["refuse", "refuse"]
    broker._sockets[-1].shutdown(2)
    while sink.step() is None:
        pass

    assert sink.step() is None
    assert sink.level == "3.1.1"
    (fault,) = sink.faults
    assert "spoke MQTT 5 and now speaks only 3.1.1" in fault


def test_a_refused_login_shows_that_the_broker_speaks_5(broker: ScriptedBroker) -> None:
    """The question comes with another client id, which access rules may refuse: that is an answer at level 5."""
    at = Broker("127.0.0.1", broker.port, "level")
    while not Connection.speaks_5(at):  # it waits 2 s for an answer: too short for a very slow machine
        pass
    broker.connects = ["refuse"]
    assert not Connection.speaks_5(at)
