"""Real brokers: mosquitto where it is installed, amqtt as well; each missing one is skipped with a message."""

import random
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from real_brokers import mosquitto, require
from recorded_presses import path, store
from scripted_broker import ScriptedBroker
from waiting import PATIENCE_S

from edge.core.backoff import Backoff
from edge.core.errors import SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from plugins.sinks.mqtt import MqttSink, plugin
from plugins.sinks.mqtt_options import MqttOptions

__all__ = ["PATIENCE_S", "mosquitto", "path", "require", "store"]

ROOT = "gelgate/plant/line1/press2/gel/v1"


# What amqtt does otherwise than mosquitto at 3.1.1 shows in the tests of the sink; others try it in `make test-lab`.
seldom_amqtt = pytest.mark.parametrize(
    "any_broker",
    ["mosquitto-5", "mosquitto-3.1.1", pytest.param("amqtt", marks=pytest.mark.lab)],
    indirect=True,
)


@pytest.fixture(params=["mosquitto-5", "mosquitto-3.1.1", "amqtt"])
def any_broker(request: pytest.FixtureRequest) -> Iterator[tuple[LocalBroker, str]]:
    """Each broker, with the protocol option to use: MQTT 5, 3.1.1 by choice, and 3.1.1 because nothing else works."""
    kind, _, level = request.param.partition("-")
    require(kind)
    with LocalBroker(kind) as broker:
        yield broker, level or "auto"


class Listener:
    """A subscriber that keeps its messages."""

    def __init__(
        self, broker: LocalBroker, topic_filter: str = "gelgate/#", client_id: str = "listener"
    ) -> None:
        self._changed = threading.Condition()
        self.heard: list[Received] = []
        self._connection = Connection.open(
            Broker(broker.host, broker.port, client_id, level=broker.level, timeout_s=PATIENCE_S),
            on_received=self._note,  # type: ignore[arg-type]
        )
        self._connection.subscribe(topic_filter)

    def _note(self, message: Received) -> None:
        with self._changed:
            self.heard.append(message)
            self._changed.notify_all()

    def payloads(self, topic: str) -> list[bytes]:
        return [m.payload for m in self.heard if m.topic == f"{ROOT}/{topic}"]

    def wait_for(self, is_heard: Callable[["Listener"], bool], timeout_s: float = PATIENCE_S) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: is_heard(self), timeout_s), f"heard only {self.heard}"

    def ask(self, verb: str, payload: bytes) -> None:
        self._connection.publish(Message(f"{ROOT}/cmd/{verb}", payload))

    def close(self) -> None:
        self._connection.close()


@pytest.fixture
def listen() -> Iterator[Callable[..., Listener]]:
    """Opens listeners, and closes them at the end."""
    opened: list[Listener] = []

    def make(*arguments: object, **options: object) -> Listener:
        opened.append(Listener(*arguments, **options))  # type: ignore[arg-type]
        return opened[-1]

    yield make
    for listener in opened:
        listener.close()


@pytest.fixture
def sink_to() -> Iterator[Callable[..., MqttSink]]:
    """Opens sinks of one station with a will and a birth, and closes them at the end. They wait long for an answer."""
    opened: list[MqttSink] = []

    def make(
        broker: LocalBroker | ScriptedBroker,
        on_command: Callable[[str, bytes], bytes] | None = None,
        station: Station | None = None,
        **options: object,
    ) -> MqttSink:
        usual = Station(
            ROOT,
            client_id="press2",
            will=Message("state", b'{"state":"lost"}', retain=True),
            birth=lambda: [Message("state", b'{"state":"ready"}', retain=True)],
            on_command=on_command,
        )
        address = {"host": "127.0.0.1", "port": broker.port, "retry_s": 1.0, "acknowledge_s": PATIENCE_S}
        opened.append(plugin.open(MqttOptions.model_validate({**address, **options}), station or usual))
        return opened[-1]

    yield make
    for sink in opened:
        sink.close()


@pytest.fixture
def scripted() -> Iterator[ScriptedBroker]:
    with ScriptedBroker() as broker:
        yield broker


@pytest.fixture
def stepped() -> Iterator[Callable[..., MqttSink]]:
    """Opens sinks without threads, whose turns a test takes, and closes them at the end."""
    opened: list[MqttSink] = []

    def make(
        broker: LocalBroker | ScriptedBroker,
        *birth: Message,
        station: Station | None = None,
        **options: object,
    ) -> MqttSink:
        address = {"host": "127.0.0.1", "port": broker.port, "protocol": "5", "acknowledge_s": PATIENCE_S}
        chosen = MqttOptions.model_validate({**address, **options})
        context = station or Station(ROOT, "press2", birth=lambda: birth)
        backoff = Backoff(random.Random(0), 0.2, 1.0)
        opened.append(MqttSink(chosen.broker(context.client_id), context, backoff))
        return opened[-1]

    yield make
    for sink in opened:
        sink.close()


SinkTo = Callable[..., MqttSink]
Listen = Callable[..., Listener]


def sent(sink: MqttSink, message: Message, timeout_s: float = PATIENCE_S) -> None:
    """Send, trying again while the broker is away."""
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return sink.send(message)
        except SinkUnavailable:
            assert time.monotonic() < deadline
            time.sleep(0.05)
