"""Publishes to an MQTT broker, at level 5 or, if the broker does not support it, 3.1.1.

A separate thread keeps the connection, so a broker that is absent is normal: `send` raises SinkUnavailable until the
broker is back. On every connection the sink first subscribes to the commands and publishes the birth messages of the
station; only then do other messages pass. The last will says that the station is lost.

What it does not do: it stores nothing (the outbox does), never uses QoS 2 (results carry an id), and has no websockets.
At level 3.1.1 a broker acknowledges messages that its access rules then discard; only level 5 reports this.

Ref: MQTT 5.0 and 3.1.1 (OASIS). Seen with mosquitto 2.0.11 and amqtt 0.12.1.
"""

import contextlib
import logging
import queue
import random
import threading
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from edge.core.backoff import Backoff
from edge.core.errors import ConfigError, SinkError, SinkRejected, SinkUnavailable
from edge.core.plugins import SinkPlugin
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.messaging.mqtt_connection import Broker, Connection, Level, LevelRefused, Outgoing, Received, Tls

__all__ = ["Mqtt", "MqttOptions", "MqttSink", "TlsOptions", "plugin"]

log = logging.getLogger(__name__)

# A level 3.1.1 broker cannot report "too large": it closes the connection. Three closings in a row, each while the same
# message waited for its acknowledgement on an established connection, are taken as that report.
STRIKES: Final = 3

# Requests that may wait while one is answered; a person or a line controller sends fewer at once.
WAITING_COMMANDS: Final = 16


class TlsOptions(BaseModel):
    """The files of an encrypted connection; an empty table trusts the system's certificate authorities."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    ca: Path | None = Field(
        default=None,
        description="PEM of the certificate authorities to trust; those of the system by default",
    )
    cert: Path | None = Field(default=None, description="PEM of this gateway's certificate, for mutual TLS")
    key: Path | None = Field(default=None, description="PEM of the key, if it is not in `cert`")

    @model_validator(mode="after")
    def _key_with_cert(self) -> Self:
        if self.key is not None and self.cert is None:
            raise ValueError("key needs cert; name both files")
        return self


class MqttOptions(BaseModel):
    """Where the broker is. The password is in a separate file, so that the configuration can be shown."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = Field(default="localhost", min_length=1, description="the broker's name or address")
    port: int | None = Field(default=None, ge=1, le=65535, description="by default 1883, or 8883 with TLS")
    protocol: Literal["auto", "5", "3.1.1"] = Field(
        default="auto", description="MQTT level; auto: 5, or 3.1.1 if the broker does not support it"
    )
    client_id: str | None = Field(
        default=None,
        min_length=1,
        description="unique in the plant; made from the station's names by default",
    )
    username: str | None = Field(default=None, description="user name for the broker")
    password_file: Path | None = Field(default=None, description="file that holds only the password")
    tls: TlsOptions | None = Field(default=None, description="encrypt the connection; a separate table")
    keepalive_s: int = Field(
        default=15, ge=1, le=3600, description="a broker that is silent for 1.5 times this is lost"
    )
    acknowledge_s: float = Field(default=10.0, gt=0, description="longest wait for the PUBACK of a message")
    retry_s: float = Field(default=30.0, ge=1, description="the longest pause between attempts to connect")

    @model_validator(mode="after")
    def _password_with_name(self) -> Self:
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file needs username; give both")
        return self

    def address(self) -> tuple[str, int]:
        """Where the broker listens. Errors: ConfigError for a password or TLS file that cannot be used."""
        broker = self.broker("check")
        return broker.host, broker.port

    def broker(self, client_id: str) -> Broker:
        """The broker to connect to. Errors: ConfigError for a password or TLS file that cannot be used."""
        return Broker(
            host=self.host,
            port=self.port or (1883 if self.tls is None else 8883),
            client_id=self.client_id or client_id,
            username=self.username,
            password=None if self.password_file is None else _password(self.password_file),
            tls=None if self.tls is None else Tls(self.tls.ca, self.tls.cert, self.tls.key).context(),
            keepalive_s=self.keepalive_s,
            timeout_s=self.acknowledge_s,
            level=None if self.protocol == "auto" else self.protocol,
        )


class MqttSink:
    """Messages of one station to one broker. Any thread may send; messages of one thread keep their order."""

    def __init__(self, broker: Broker, station: Station, backoff: Backoff) -> None:
        self._broker = broker
        self._station = station
        self._backoff = backoff
        self._closing = threading.Event()
        self._tried = threading.Event()  # the first attempt to connect has ended
        self._connection: Connection | None = None
        self._worked: Level | None = None  # the level of the last connection
        self._why_down = f"not yet connected to broker {broker}"
        self._struck: tuple[Message | None, int] = (None, 0)
        # What the birth of this connection published on each topic: the publisher holds the same, and once is enough.
        self._born: dict[str, Message] = {}
        self._requests: queue.Queue[Received | None] = queue.Queue(WAITING_COMMANDS)
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

    def send(self, message: Message) -> None:
        """Publish, and return on the broker's acknowledgement. Errors: SinkUnavailable, SinkRejected.

        A message that the birth of this connection has just published is not published again.
        """
        self._tried.wait(self._broker.timeout_s)
        connection = self._connection
        if connection is None:
            raise SinkUnavailable(self._why_down)
        if self._born.pop(message.topic, None) == message:
            return
        try:
            connection.publish(self._outgoing(message))
        except SinkUnavailable as error:
            self._strike(message, connection, error)
            raise
        if self._struck[0] == message:
            self._struck = (None, 0)

    def close(self) -> None:
        """Disconnect from the broker, so that it does not publish the will; harmless when repeated."""
        self._closing.set()
        connection = self._connection
        if connection is not None:
            connection.close()
        with contextlib.suppress(queue.Empty):
            while True:
                self._requests.get_nowait()
        self._requests.put(None)
        for thread in filter(threading.Thread.is_alive, self._threads):
            thread.join(self._broker.timeout_s)

    def step(self) -> float | None:
        """One turn of the connecting thread: try to connect where there is no connection.

        Gives the pause before the next turn in seconds, None while there is a connection. Never raises.
        """
        if self._connection is not None and self._lost.is_set():
            self._note_loss()
        if self._connection is not None:
            return None
        self._lost = threading.Event()
        try:
            connection = self._connect(self._lost)
        except (
            Exception
        ) as error:  # the thread's outermost level: otherwise the sink would stay down for ever
            if not isinstance(error, SinkError):
                log.exception("connecting to broker %s failed with an unexpected error", self._broker)
            if isinstance(error, LevelRefused):
                self._worked = None  # perhaps another broker now: find its level again
            self._down(str(error))
            self._tried.set()
            return self._backoff.failed()
        self._backoff.succeeded()
        self._connection = connection
        log.info("connected to broker %s, MQTT %s", self._broker, connection.level)
        self._tried.set()
        if self._closing.is_set():
            connection.close()
        return None

    def _keep_connected(self) -> None:
        while not self._closing.is_set():
            pause_s = self.step()
            if pause_s is None:
                self._lost.wait()
                self._note_loss()
            else:
                self._closing.wait(pause_s)

    def _note_loss(self) -> None:
        connection, self._connection = self._connection, None
        why = connection.why_lost if connection is not None else None
        self._down(f"the connection to broker {self._broker} is lost ({why or 'it was closed'})")

    def _connect(self, lost: threading.Event) -> Connection:
        will = self._station.will
        connection = Connection.open(
            replace(self._broker, level=self._broker.level or self._worked),
            will=None if will is None else self._outgoing(will),
            on_received=self._received,
            on_lost=lost.set,
        )
        self._worked = connection.level
        try:
            if self._station.on_command is not None:
                connection.subscribe(f"{self._station.root}/cmd/+", wants_retained=False)
            birth = self._station.birth()
            for message in birth:
                connection.publish(self._outgoing(message))
            self._born = {message.topic: message for message in birth}
        except Exception:
            connection.abandon("its birth failed")
            raise
        return connection

    def _down(self, why: str) -> None:
        if why != self._why_down and not self._closing.is_set():
            log.warning("%s", why)
        self._why_down = why

    def _strike(self, message: Message, connection: Connection, error: SinkUnavailable) -> None:
        if connection.is_up or self._closing.is_set():
            return
        struck, strikes = self._struck
        strikes = strikes + 1 if struck == message else 1
        self._struck = (message, strikes)
        if strikes >= STRIKES:
            self._struck = (None, 0)
            raise SinkRejected(
                f"broker {self._broker} closed the connection {strikes} times on the same message on "
                f"{message.topic}, {len(message.payload)} bytes; it may be larger than the broker allows"
            ) from error

    def _outgoing(self, message: Message) -> Outgoing:
        return Outgoing(
            self._station.topic(message),
            message.payload,
            message.qos,
            message.retain,
            message.content_type,
            message.expiry_s,
        )

    def _received(self, request: Received) -> None:
        if request.retain:
            log.warning(
                "a retained request on %s is ignored: it would run at every connection", request.topic
            )
            return
        try:
            self._requests.put_nowait(request)
        except queue.Full:
            log.warning("a request on %s is dropped: %d are waiting", request.topic, WAITING_COMMANDS)

    def _serve(self) -> None:
        while (request := self._requests.get()) is not None:
            self.answer(request)

    def answer(self, request: Received) -> None:
        """One turn of the answering thread: do what is asked and publish the response."""
        connection, command = self._connection, self._station.on_command
        if command is None or self._closing.is_set():
            return
        response = Outgoing(
            request.response_topic or f"{request.topic}/response",
            command(request.topic.rpartition("/")[2], request.payload),
            content_type="application/json",
            correlation=request.correlation,
        )
        try:
            if connection is not None:
                connection.publish(response)
        except SinkError as error:
            log.warning("a response is not delivered: %s", error)


class Mqtt(SinkPlugin[MqttOptions]):
    """The plugin."""

    Options = MqttOptions

    def open(self, options: MqttOptions, station: Station) -> MqttSink:
        """A sink that starts to connect. Errors: ConfigError for a password or TLS file that cannot be used."""
        backoff = Backoff(random.Random(station.client_id), first_s=0.2, ceiling_s=options.retry_s)
        return MqttSink(options.broker(station.client_id), station, backoff).start()


plugin = Mqtt()


def _password(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"password file {path} cannot be read: {error}") from error
