"""Publishes to an MQTT broker, at level 5 or, if the broker proves that it does not support it, 3.1.1.

A separate thread keeps the connection, so a broker that is absent is normal: `send` raises SinkUnavailable until the
broker is back. On every connection the sink first subscribes to the commands and publishes the birth messages of the
station; only then do other messages pass. The last will says that the station is lost; a second connection has that of
`availability`.

What it does not do: it stores nothing (the outbox does), never uses QoS 2 (results carry an id), and has no websockets.
At level 3.1.1 a broker acknowledges messages that its access rules then discard; only level 5 reports this. So silence
never leads from 5 to 3.1.1, and a sink at 3.1.1 keeps trying 5.

Ref: MQTT 5.0 and 3.1.1 (OASIS). Seen with mosquitto 2.0.11 and amqtt 0.12.1.
"""

import json
import logging
import random
import threading
from collections.abc import Container, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final, Self

from edge.clock import SystemClock
from edge.core.backoff import Backoff
from edge.core.errors import SinkError, SinkRejected, SinkUnavailable
from edge.core.plugins import SinkPlugin
from edge.core.ports import Clock, Message
from edge.core.sink_context import Station
from edge.messaging.descriptions.dashboards import discovery, discovery_topic
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.mqtt_broker import Broker, Level, LevelRefused, Received
from edge.messaging.mqtt_connection import Connection
from plugins.sinks.mqtt_availability import Availability
from plugins.sinks.mqtt_options import MqttOptions
from plugins.sinks.mqtt_requests import Requests
from plugins.sinks.mqtt_strikes import Strikes

__all__ = ["Mqtt", "MqttSink", "plugin"]

log = logging.getLogger(__name__)

# What a connection lacks, level 5 or the second connection, is tried after this time, then after twice as long, up to
# the second.
AGAIN_FIRST_S: Final = 10.0
AGAIN_LAST_S: Final = 600.0

# A connection that the broker closes sooner is a short one; that many in a row are no chance.
SHORT_S: Final = 5.0
SHORT_ONES: Final = 3

_UNTOLD: Final = "closed here, and the broker was not told the end"


class MqttSink:
    """Messages of one station to one broker. Any thread may send; messages of one thread keep their order."""

    def __init__(
        self,
        broker: Broker,
        station: Station,
        backoff: Backoff,
        *,
        has_availability: bool = True,
        announcements: Sequence[Message] = (),
        clock: Clock | None = None,
    ) -> None:
        self._broker = broker
        self._clock = clock or SystemClock()
        self._station = station
        self._backoff = backoff
        self._closing = threading.Event()
        self._tried = threading.Event()  # the first attempt to connect has ended
        self._connection: Connection | None = None
        self._worked: Level | None = None  # the level of the last connection
        self._had_5 = False
        self._why_down = f"not yet connected to broker {broker}"
        self._strikes = Strikes()
        self._faults: dict[str, str] = {}
        self._refused: dict[str, str] = {}  # by topic of the birth, and why
        self._publishing = threading.Lock()  # what is offered again comes never after what is newer
        self._connected_ns = 0
        self._short_ones = 0
        self.look_again_s = AGAIN_FIRST_S
        # What the birth of this connection published on each topic: the publisher holds the same, and once is enough.
        self._born: dict[str, Message] = {}
        self._is_offline_sent = self._is_end_sent = False  # first `offline`, then the state of the end
        self._requests = Requests(station)
        offline = None if station.offline is None else self._full(station.offline)
        self._announcements = announcements  # on topics of their own, after every birth
        self._availability = Availability(broker, offline, self._clock, is_wanted=has_availability)
        self._lost = threading.Event()  # of the connection in use, or of the last attempt
        self._threads = [
            threading.Thread(target=self._keep_connected, name="mqtt-connect", daemon=True),
            threading.Thread(target=self._serve, name="mqtt-commands", daemon=True),
        ]

    def start(self) -> Self:
        """Connect, stay connected and answer requests, in two threads; `step` and `answer` are their turns."""
        for thread in self._threads:
            thread.start()
        return self

    @property
    def level(self) -> str | None:
        """The protocol level in use, None while there is no connection."""
        connection = self._connection
        return None if connection is None else connection.level

    @property
    def faults(self) -> Sequence[str]:
        """Faults to correct although messages pass, one sentence each."""
        own = dict(self._faults).values()
        faults = [*own, self._say_refused(), *self._strikes.faults, self._availability.fault]
        return [fault for fault in faults if fault is not None]

    def _say_refused(self) -> str | None:
        refused = list(dict(self._refused).values())
        return f"{len(refused)} of the station's own messages are refused: {refused[0]}" if refused else None

    def send(self, message: Message) -> None:
        """Publish, and return on the broker's acknowledgement. Errors: SinkUnavailable, SinkRejected.

        A message that the birth of this connection has just published is not published again.
        """
        self._tried.wait(self._broker.timeout_s)
        if (connection := self._connection) is None:
            raise SinkUnavailable(self._why_down)
        if self._born.pop(message.topic, None) == message:
            self._strikes.delivered(message)
            return
        offline, will = self._station.offline, self._station.will
        if offline is not None and message.topic == offline.topic:
            self._is_offline_sent, self._is_end_sent = message == offline, False
        elif will is not None and message.topic == will.topic:
            self._is_end_sent = self._is_offline_sent or offline is None
        try:
            with self._publishing:
                was_up = connection.is_up  # else it is not sent: its loss is not noted yet
                connection.publish(self._outgoing(message))
        except SinkUnavailable as error:
            if was_up and not (connection.is_up or self._closing.is_set()):
                self._strikes.lost(message, connection, error)
            raise
        except SinkRejected as error:
            if any(own.topic == message.topic for own in self._station.birth()):
                self._refused[message.topic] = str(error)
            raise
        self._strikes.delivered(message)
        self._refused.pop(message.topic, None)

    def close(self) -> None:
        """Disconnect from the broker; harmless when repeated.

        One that was not told that the station ends, because it hangs or its birth is not over, publishes the wills.
        """
        self._closing.set()
        connection, is_told = self._connection, self._is_end_sent or self._station.will is None
        if connection is not None and not is_told:
            connection.abandon(_UNTOLD)
        elif connection is not None:
            connection.close()
        self._requests.close()
        for thread in filter(threading.Thread.is_alive, self._threads):
            thread.join(self._broker.timeout_s)
        (self._availability.close if is_told else self._availability.abandon)()

    def step(self) -> float | None:
        """Do one turn of the connecting thread: try to connect where there is no connection.

        Gives the pause before the next turn in seconds, None while there is a connection. Never raises.
        """
        if self._connection is not None and self._lost.is_set():
            self._see_loss()
        if self._connection is not None:
            return None
        self._lost = threading.Event()
        try:
            connection = self._connect(self._lost)
        except Exception as error:  # the thread's outermost level: else the sink would stay down for ever
            if not isinstance(error, SinkError):
                log.exception("connecting to broker %s failed with an unexpected error", self._broker)
            if isinstance(error, LevelRefused):
                self._worked = None  # perhaps another broker now: find its level again
            self._down(str(error))
            self._tried.set()
            return self._backoff.failed()
        self._backoff.succeeded()
        self._connection = connection
        self._connected_ns = self._clock.monotonic_ns()
        log.info("connected to broker %s, MQTT %s", self._broker, connection.level)
        self._tried.set()
        if self._closing.is_set():
            connection.abandon(_UNTOLD)
        return None

    def look_again(self) -> None:
        """Do what is due when a connection has lasted for `look_again_s`: soon, and more seldom what is in vain."""
        self._faults.pop("client id", None)
        is_in_vain = self._is_at_lower_level or self._availability.is_missing
        self.look_again_s = min(2 * self.look_again_s, AGAIN_LAST_S) if is_in_vain else AGAIN_FIRST_S
        self.find_level()
        self.find_availability()
        self.offer_refused()

    @property
    def _is_at_lower_level(self) -> bool:
        """True where level 5 was not chosen, and may be had later."""
        return self.level == "3.1.1" and self._broker.level is None

    def find_level(self) -> None:
        """Ask again for level 5 where the broker chose 3.1.1, and connect again if it answers."""
        connection = self._connection
        if connection is not None and self._is_at_lower_level and Connection.speaks_5(self._broker):
            log.info("broker %s speaks MQTT 5 now; connecting again", self._broker)
            self._worked = None
            self.look_again_s = AGAIN_FIRST_S
            connection.close()

    def find_availability(self) -> None:
        """Try again to open the second connection where it could not be kept."""
        connection = self._connection
        if connection is not None and self._availability.is_missing:
            self._availability.open(connection.level, self._lost.set)
            self._say_availability(connection)

    def offer_refused(self) -> None:
        """Ask again for what the broker refused at the birth, as it is now: its rules may be others."""
        connection = self._connection
        if connection is None:
            return
        with suppress(SinkUnavailable):  # a lost connection is seen in the next turn
            if "commands" in self._faults:
                self._subscribe(connection)
            if self._refused:
                with self._publishing:
                    self._offer(connection, set(self._refused))

    def answer(self, request: Received) -> None:
        """Do what a request asks and publish the response: one turn of the answering thread."""
        if not self._closing.is_set():
            self._requests.answer(request, self._connection)

    def _keep_connected(self) -> None:
        while not self._closing.is_set():
            pause_s = self.step()
            if pause_s is not None:
                self._closing.wait(pause_s)
            elif not self._lost.wait(self.look_again_s):
                self.look_again()

    def _serve(self) -> None:
        while (request := self._requests.next()) is not None:
            self.answer(request)

    def _see_loss(self) -> None:
        """Handle the loss of one of the two connections: the second alone is opened again."""
        connection, lost = self._connection, self._lost
        lost.clear()
        if connection is None or not connection.is_up or self._closing.is_set():
            self._note_loss()
            return
        self._availability.renew(connection.level, lost.set)
        self._say_availability(connection)

    def _say_availability(self, connection: Connection) -> None:
        for message in self._station.birth():
            if self._station.offline is not None and message.topic == self._station.offline.topic:
                with suppress(SinkError):  # a lost connection is seen in the next turn
                    connection.publish(self._outgoing(message))

    def _note_loss(self) -> None:
        connection, self._connection = self._connection, None
        if not self._closing.is_set():
            self._availability.abandon()
        why = connection.why_lost if connection is not None else None
        if connection is not None and not self._closing.is_set():
            self._suspect_client_id(connection)
        self._down(f"the connection to broker {self._broker} is lost ({why or 'it was closed'})")

    def _suspect_client_id(self, connection: Connection) -> None:
        lasted_ns = self._clock.monotonic_ns() - self._connected_ns
        is_short = lasted_ns < SHORT_S * 1e9 and not connection.was_given_up
        self._short_ones = self._short_ones + 1 if is_short else 0
        if connection.was_taken_over or (self._short_ones >= SHORT_ONES and not self._strikes.is_suspecting):
            self._faults["client id"] = (
                f"broker {self._broker} closes this station's connections soon after it accepts them; another client "
                f"uses the client id '{self._broker.client_id}', it seems: give each its own (client_id)"
            )

    def _connect(self, lost: threading.Event) -> Connection:
        will = self._station.will
        connection = Connection.open(
            replace(self._broker, level=self._broker.level or self._worked),
            will=None if will is None else self._outgoing(will),
            on_received=self._received,
            on_lost=lost.set,
        )
        self._note_level(connection.level)
        try:
            self._availability.open(connection.level, lost.set)
            self._born = self._bear(connection)
        except Exception:
            connection.abandon("its birth failed")
            self._availability.abandon()
            raise
        return connection

    def _note_level(self, level: Level) -> None:
        self._worked = level
        self._had_5 |= level == "5"
        self._faults.pop("level", None)
        if level != "5" and self._had_5:
            self._faults["level"] = (
                f"broker {self._broker} spoke MQTT 5 and now speaks only 3.1.1, at which it may discard forbidden "
                'messages without a word; set protocol = "5", and update the broker'
            )

    def _bear(self, connection: Connection) -> dict[str, Message]:
        """The first messages of a connection; those published. What the broker refuses stops nothing else."""
        if self._station.on_command is not None:
            self._subscribe(connection)
        born = self._offer(connection)
        self._strikes.has_proof = bool(born)
        if self._refused:
            log.warning("%s", self._say_refused())
        return born

    def _offer(self, connection: Connection, topics: Container[str] | None = None) -> dict[str, Message]:
        """Publish the station's own messages, or those of these topics; those that the broker takes, by topic."""
        taken, refused = dict[str, Message](), dict[str, str]()
        own = [(message, self._outgoing(message)) for message in self._station.birth()]
        for message, outgoing in [*own, *((one, one) for one in self._announcements)]:
            if topics is None or message.topic in topics:
                try:
                    connection.publish(outgoing)
                    taken[message.topic] = message
                except SinkRejected as error:
                    refused[message.topic] = str(error)
        self._refused = refused  # at once: a fault that goes for a moment would end its alarm
        return taken

    def _subscribe(self, connection: Connection) -> None:
        try:
            connection.subscribe(f"{self._station.root}/cmd/+", wants_retained=False)
            self._faults.pop("commands", None)
        except SinkRejected as error:
            fault = f"no request can arrive: {error}"
            if self._faults.get("commands") != fault:
                log.warning("%s", fault)
            self._faults["commands"] = fault

    def _down(self, why: str) -> None:
        if why != self._why_down and not self._closing.is_set():
            log.warning("%s", why)
        self._why_down = why

    def _outgoing(self, message: Message) -> Message:
        return self._availability.outgoing(self._full(message))

    def _full(self, message: Message) -> Message:
        return replace(message, topic=self._station.topic(message))

    def _received(self, request: Received) -> None:
        self._requests.receive(request, self._connection)  # none while its birth is published


class Mqtt(SinkPlugin[MqttOptions]):
    """The plugin."""

    Options = MqttOptions

    def open(self, options: MqttOptions, station: Station) -> MqttSink:
        """Start to connect. Errors: ConfigError for a password or TLS file that cannot be used."""
        return self.make(options, station, SystemClock()).start()

    def make(self, options: MqttOptions, station: Station, clock: Clock) -> MqttSink:
        """Make a sink that has not started. Errors: those of `open`."""
        backoff = Backoff(random.Random(station.client_id), first_s=0.2, ceiling_s=options.retry_s)
        broker = options.broker(station.client_id)
        return MqttSink(
            broker,
            station,
            backoff,
            has_availability=options.availability,
            announcements=_announcements(options, station),
            clock=clock,
        )


def _announcements(options: MqttOptions, station: Station) -> list[Message]:
    if options.home_assistant is None:
        return []
    described = DescribedStation.of_root(station.root)
    described = replace(described, picture_type=station.picture_type, keeps_heatmap=True)
    topic = discovery_topic(described, options.home_assistant)
    return [Message(topic, json.dumps(discovery(described)).encode(), retain=True)]


plugin = Mqtt()
