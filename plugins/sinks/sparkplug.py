"""Publishes to a Sparkplug B host, such as a SCADA system: the station is an edge node, its values are metrics.

It connects when something is to be sent, at the latest with the next `stats`. On every connection it publishes a birth
certificate (NBIRTH) with all metrics; the last will is the death certificate (NDEATH) with the same `bdSeq`. A host
that asks for a rebirth gets one. Results that were sent late are historical metrics with the time of their press.

What it does not do: pictures and overview stills are left out, and it takes no command but the rebirth. Sparkplug sends
data at QoS 0: what is under way while the connection breaks is lost, and only the `mqtt` sink delivers every result.
It does not wait for a primary host.

Ref: Eclipse Sparkplug 3.0.0. Seen with mosquitto 2.0.11; payloads read by Eclipse Tahu's sparkplug-payload 1.0.
"""

import logging
import threading
import time
from dataclasses import replace
from typing import Final

from pydantic import Field

from edge.core.errors import SinkError, SinkRejected
from edge.core.plugins import SinkPlugin
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.messaging.descriptions.station import SparkplugNode
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from plugins.sinks.mqtt_options import BrokerOptions, TopicLevel
from plugins.sinks.sparkplug_metrics import DataType, Metric, decode, encode, initial_metrics, metrics_of

__all__ = ["Sparkplug", "SparkplugOptions", "SparkplugSink", "plugin"]

log = logging.getLogger(__name__)

_REBIRTH: Final = "Node Control/Rebirth"


class SparkplugOptions(BrokerOptions):
    """The broker of the Sparkplug host, and the node's names there."""

    group: TopicLevel | None = Field(default=None, description="group id; the station's site by default")
    node: TopicLevel | None = Field(default=None, description="edge node id; `<line>-<station>` by default")


class SparkplugSink:
    """One edge node without devices. Any thread may send; the host's requests arrive on the connection's own thread."""

    def __init__(self, broker: Broker, station: Station, node: SparkplugNode) -> None:
        self._broker = broker
        self._station = station
        self._node = node
        self._lock = threading.RLock()  # of the values and of seq: their order is that of the messages
        self._connection: Connection | None = None
        self._values = {metric.name: metric for metric in initial_metrics(_now_ms())}
        self._seq = 0
        self._rebirth = threading.Thread()  # the last one
        # It rises with every connection. The start is another one after a restart, so that an old NDEATH is not that of
        # the new session.
        self._bd_seq = int(time.time()) % 256

    @property
    def level(self) -> str | None:
        """The protocol level in use, None while there is no connection."""
        connection = self._connection
        return connection.level if connection is not None and connection.is_up else None

    def send(self, message: Message) -> None:
        """Publish the metrics that the message changes; one without metrics is done once there is a broker.

        Errors: SinkUnavailable while there is no broker; SinkRejected for what is not the station's.
        """
        try:
            changed = list(metrics_of(message, _now_ms()))
        except (ValueError, TypeError) as error:
            raise SinkRejected(f"the message on {message.topic} has no metrics: {error}") from error
        with self._lock:
            connection = self._connected()
            if not changed:
                return
            self._values.update({metric.name: replace(metric, is_historical=False) for metric in changed})
            connection.publish(self._outgoing("NDATA", changed))

    def close(self) -> None:
        """Say goodbye with the death certificate, which a DISCONNECT alone would suppress. May be called again."""
        with self._lock:
            connection, self._connection = self._connection, None
        if connection is None:
            return
        try:
            if connection.is_up:
                connection.publish(self._death())
        except SinkError as error:
            log.debug("the death certificate is left to the broker: %s", error)
        connection.close()

    def _connected(self) -> Connection:
        """The connection in use, or a new one with a birth. Errors: SinkUnavailable."""
        if self._connection is not None and self._connection.is_up:
            return self._connection
        self._bd_seq = (self._bd_seq + 1) % 256
        for message in self._station.birth():
            for metric in metrics_of(message, _now_ms()):
                self._values[metric.name] = metric
        connection = Connection.open(self._broker, will=self._death(), on_received=self._received)
        try:
            connection.subscribe(self._node.topic("NCMD"), wants_retained=False)
            connection.publish(self._birth())
        except SinkError:
            connection.abandon("its birth failed")
            raise
        self._connection = connection
        log.info("sparkplug node %s is born at broker %s", self._node, self._broker)
        return connection

    def _received(self, request: Received) -> None:
        """On the connection's thread, which must not wait for one that publishes: the rebirth has its own."""
        try:
            is_rebirth = (_REBIRTH, True) in decode(request.payload)
        except ValueError as error:
            log.warning("a request on %s is left out: %s", request.topic, error)
            return
        if is_rebirth and not self._rebirth.is_alive():
            self._rebirth = threading.Thread(
                target=self._be_born_again, name="sparkplug-rebirth", daemon=True
            )
            self._rebirth.start()

    def _be_born_again(self) -> None:
        with self._lock:
            connection = self._connection
            if connection is not None and connection.is_up:
                try:
                    connection.publish(self._birth())
                except SinkError as error:
                    log.warning("no rebirth: %s", error)

    def _birth(self) -> Message:
        """The seq of a birth is 0, the bdSeq that of the connection's will."""
        self._seq = -1
        now = _now_ms()
        own = [
            Metric("bdSeq", DataType.INT64, self._bd_seq, now),
            Metric(_REBIRTH, DataType.BOOLEAN, False, now),
        ]
        return self._outgoing("NBIRTH", [*own, *self._values.values()])

    def _death(self) -> Message:
        now = _now_ms()
        payload = encode([Metric("bdSeq", DataType.INT64, self._bd_seq, now)], now, None)
        return Message(self._node.topic("NDEATH"), payload, qos=1, content_type="")

    def _outgoing(self, verb: str, metrics: list[Metric]) -> Message:
        self._seq = (self._seq + 1) % 256
        return Message(self._node.topic(verb), encode(metrics, _now_ms(), self._seq), qos=0, content_type="")


def _now_ms() -> int:
    return time.time_ns() // 1_000_000


class Sparkplug(SinkPlugin[SparkplugOptions]):
    """The plugin."""

    Options = SparkplugOptions

    def open(self, options: SparkplugOptions, station: Station) -> SparkplugSink:
        """A sink that connects with its first message. Errors: ConfigError for a password or TLS file that cannot be
        used."""
        broker = options.broker(f"{station.client_id}-sparkplug")
        return SparkplugSink(broker, station, SparkplugNode.of(station.root, options.group, options.node))


plugin = Sparkplug()
