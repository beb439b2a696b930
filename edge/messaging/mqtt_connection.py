"""One connection to an MQTT broker, at its protocol level: 5, or 3.1.1 where the broker does not speak 5.

Used by the MQTT sink and by subscribers. A `Connection` never reconnects. When it is lost it is discarded with
everything that the library had queued, so a message that was given up is not sent later.

Ref: MQTT 5.0 (OASIS, 2019), MQTT 3.1.1 (OASIS, 2014), paho-mqtt 2.x. Seen with mosquitto 2.0 (both levels) and amqtt
0.12 (3.1.1 alone; it drops a level 5 CONNECT without an answer, or waits).
"""

import contextlib
import logging
import socket
import ssl
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Final, Self

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from edge.core.errors import SinkError, SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.messaging.mqtt_broker import Broker, Level, LevelRefused, LoginRefused, NoAnswer, Received

__all__ = ["Connection"]

log = logging.getLogger(__name__)

# PUBACK codes that refuse a message for ever: not authorized, topic name invalid, payload format invalid. The other
# failures (quota, unspecified, implementation specific) are about the broker's present state and may end.
_REFUSALS: Final = frozenset({0x87, 0x90, 0x99})

# Room for a PUBLISH packet's fields other than topic and payload: header, ids and our three properties.
_PACKET_OVERHEAD_BYTES: Final = 128

# While the level is not known, the wait for a silent broker is shorter. amqtt 0.12 reads a level 5 CONNECT with a will
# as one of 3.1.1, and waits for bytes that never come.
_LEVEL_TRIAL_S: Final = 2.0

# The library's thread writes the DISCONNECT within this time, also on a loaded gateway; else the will is published.
_DISCONNECT_S: Final = 2.0

# Another client with the same client id has connected. Ref: MQTT 5.0, 3.14.2.1.
_TAKEN_OVER: Final = 0x8E

# The library's reason after 1.5 times `keepalive_s` without a packet.
_SILENT: Final = 0x8D

_RETAIN_SEND_ON_SUBSCRIBE: Final = 0
_RETAIN_DO_NOT_SEND: Final = 2


OnReceived = Callable[[Received], None]


class Connection:
    """One connection, up when it is made; once lost, it stays down. Any thread may publish.

    on_received: called from the connection's own thread; it must return at once. on_lost: likewise, once.
    """

    @classmethod
    def open(
        cls,
        broker: Broker,
        will: Message | None = None,
        on_received: OnReceived | None = None,
        on_lost: Callable[[], None] = lambda: None,
    ) -> Self:
        """Connect and wait for the broker's acknowledgement.

        Errors: SinkUnavailable, which says whether the broker is absent, silent, or refuses the connection.
        """
        make = partial(cls, will=will, on_received=on_received, on_lost=on_lost)
        if broker.level is not None:
            return make(broker, broker.level)
        trial = replace(broker, timeout_s=min(broker.timeout_s, _LEVEL_TRIAL_S))
        try:
            return make(trial, "5")._with(broker)
        except LevelRefused:
            return make(broker, "3.1.1")
        except NoAnswer as silence:
            try:
                cls(broker, "3.1.1", None, None, lambda: None).close()
            except NoAnswer:
                raise silence from None
            # It answers at 3.1.1, so it is awake now. Before, it may have hung; a second silence is about level 5.
            try:
                return make(trial, "5")._with(broker)
            except (LevelRefused, NoAnswer):
                log.warning("%s; MQTT 3.1.1 is used, which it answers", silence)
                return make(broker, "3.1.1")

    @classmethod
    def speaks_5(cls, broker: Broker) -> bool:
        """Tell whether the broker answers at level 5; a refused login is an answer too. Another client id tries it."""
        limit_s = min(broker.timeout_s, _LEVEL_TRIAL_S)
        trial = replace(broker, client_id=f"{broker.client_id}-level", timeout_s=limit_s)
        try:
            cls(trial, "5", None, None, lambda: None).close()
        except LoginRefused:
            return True
        except SinkUnavailable:
            return False
        return True

    def __init__(
        self,
        broker: Broker,
        level: Level,
        will: Message | None,
        on_received: OnReceived | None,
        on_lost: Callable[[], None],
    ) -> None:
        self.broker = broker
        self.level: Level = level
        self.why_lost = ""
        self.was_given_up = False  # lost because the broker was silent, not because it closed the connection
        self.was_taken_over = False  # lost because another client has the same client id
        self._on_received = on_received
        self._on_lost = on_lost
        self._changed = threading.Condition()
        self._consent: ReasonCode | None = None
        self._largest_packet: int | None = None
        self._is_lost = False
        self._is_established = False
        self._answers: dict[int, ReasonCode | None] = {}
        self._unasked = set[int]()  # ids of messages whose answer nobody waits for; ids come again
        self._client = self._make_client(will)
        self._establish()

    def _with(self, broker: Broker) -> Self:
        """Take the time limits of this broker."""
        self.broker = broker
        return self

    @property
    def is_up(self) -> bool:
        return self._is_established and not self._is_lost

    def publish(self, message: Message) -> None:
        """Send and wait for the acknowledgement; QoS 0 waits until it is written.

        Errors: SinkRejected for this message; SinkUnavailable when the connection is lost meanwhile, or when the
        broker does not answer, and then the connection is given up.
        """
        size = len(message.payload) + len(message.topic.encode(errors="replace")) + _PACKET_OVERHEAD_BYTES
        if self._largest_packet is not None and size > self._largest_packet:
            raise SinkRejected(
                f"broker {self.broker} takes packets up to {self._largest_packet} bytes, "
                f"this message on {message.topic} has {size}; raise its max_packet_size"
            )
        if not self.is_up:
            raise SinkUnavailable(self._lost_sentence())
        try:
            info = self._client.publish(
                message.topic, message.payload, message.qos, message.retain, self._properties(message)
            )
        except ValueError as error:
            raise SinkRejected(f"a message on {message.topic!r} cannot be sent: {error}") from error
        self._check(message, self._answer(info.mid, f"the message on {message.topic}"))

    def publish_soon(self, message: Message) -> None:
        """Send at QoS 0 without waiting; lost when the connection is. Only this may be used in `on_received`."""
        if self.is_up:
            properties = self._properties(message)
            info = self._client.publish(message.topic, message.payload, 0, message.retain, properties)
            with self._changed:
                if self._answers.pop(info.mid, self) is self:  # it is not written yet
                    self._unasked.add(info.mid)

    def subscribe(self, topic_filter: str, *, wants_retained: bool = True) -> None:
        """Subscribe and wait for the acknowledgement. Errors: SinkRejected, SinkUnavailable."""
        if self.level == "5":
            handling = _RETAIN_SEND_ON_SUBSCRIBE if wants_retained else _RETAIN_DO_NOT_SEND
            options = SubscribeOptions(qos=1, retainHandling=handling)
            _, mid = self._client.subscribe(topic_filter, options=options)
        else:
            _, mid = self._client.subscribe(topic_filter, qos=1)
        if mid is None:
            raise SinkUnavailable(self._lost_sentence())
        reason = self._answer(mid, f"the subscription to {topic_filter}")
        if reason is not None and reason.value >= 0x80:
            raise SinkRejected(f"broker {self.broker} refuses the subscription to {topic_filter}: {reason}")

    def close(self) -> None:
        """Disconnect: the will is not published. May be called again."""
        with self._changed:
            self.why_lost = self.why_lost or "closed here"
        self._client.disconnect()
        self._await(lambda: self._is_lost, _DISCONNECT_S)
        self.abandon("closed here")

    def abandon(self, why: str) -> None:
        """Close the socket without a DISCONNECT, and discard everything queued. May be called again."""
        with self._changed:
            self.why_lost = self.why_lost or why
        sock = self._client.socket()
        if isinstance(sock, socket.socket):
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)  # the library's thread sees the end and leaves
        self._lose(why)

    def _make_client(self, will: Message | None) -> paho.Client:
        is_5 = self.level == "5"
        client = paho.Client(
            CallbackAPIVersion.VERSION2,
            client_id=self.broker.client_id,
            protocol=MQTTProtocolVersion.MQTTv5 if is_5 else MQTTProtocolVersion.MQTTv311,
            clean_session=None if is_5 else True,
            reconnect_on_failure=False,
        )
        client.connect_timeout = self.broker.timeout_s
        if self.broker.username is not None:
            client.username_pw_set(self.broker.username, self.broker.password)
        if self.broker.tls is not None:
            client.tls_set_context(self.broker.tls)
        if will is not None:
            properties = self._properties(will, PacketTypes.WILLMESSAGE)
            client.will_set(will.topic, will.payload, will.qos, will.retain, properties)
        client.on_connect = lambda _, __, flags, reason, properties: self._take_consent(reason, properties)
        client.on_disconnect = lambda _, __, flags, reason, properties: self._end(flags, reason)
        client.on_publish = lambda _, __, mid, reason, properties: self._note(mid, reason)
        client.on_subscribe = lambda _, __, mid, reasons, properties: self._note(
            mid, next(iter(reasons), None)
        )
        client.on_message = lambda _, __, message: self._message(message)
        return client

    def _establish(self) -> None:
        try:
            self._client.connect(
                self.broker.host, self.broker.port, self.broker.keepalive_s, properties=self._limits()
            )
        except ssl.SSLError as error:
            raise SinkUnavailable(
                f"broker {self.broker}: TLS failed ({error}); check the ca and the host name"
            ) from error
        except (OSError, ValueError) as error:
            raise SinkUnavailable(
                f"no broker answers at {self.broker} ({error}); start it, or correct host and port"
            ) from error
        # Else a small message waits until the broker's system acknowledges the one before: up to 40 ms.
        opened = self._client.socket()
        if isinstance(opened, socket.socket) and opened.family != socket.AF_UNIX:
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client.loop_start()
        self._await(lambda: self._consent is not None or self._is_lost, self.broker.timeout_s)
        consent = self._consent
        if consent is None or consent.is_failure:
            why = self.why_lost or ("it closed the connection" if self._is_lost else "it is silent")
            self.abandon("no consent")
            raise self._refusal(consent, why)
        with self._changed:
            self._is_established = not self._is_lost
        if not self._is_established:
            raise SinkUnavailable(self._lost_sentence())

    def _refusal(self, consent: ReasonCode | None, why: str) -> SinkError:
        if consent is None:
            hint = "; with TLS, it may want this gateway's certificate (tls.cert)" if self.broker.tls else ""
            return NoAnswer(f"broker {self.broker} does not answer at MQTT {self.level} ({why}){hint}")
        if self.level == "5" and consent.value in (0x01, 0x84):
            return LevelRefused(f"broker {self.broker} does not speak MQTT 5 ({consent})")
        return LoginRefused(
            f"broker {self.broker} refuses the connection: {consent}; check user name, password file and client id"
        )

    def _limits(self) -> Properties | None:
        if self.level != "5" or self.broker.largest_packet is None:
            return None
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.MaximumPacketSize = self.broker.largest_packet
        return properties

    def _properties(self, message: Message, packet: int = PacketTypes.PUBLISH) -> Properties | None:
        if self.level != "5":
            return None
        return _make_properties(packet, message.content_type, message.expiry_s, message.correlation)

    def _answer(self, mid: int, what: str) -> ReasonCode | None:
        self._await(lambda: mid in self._answers or self._is_lost, self.broker.timeout_s)
        with self._changed:
            if mid in self._answers:
                return self._answers.pop(mid)
        if self._is_lost:
            raise SinkUnavailable(self._lost_sentence())
        why = f"it did not acknowledge {what} within {self.broker.timeout_s:g} s"
        self.was_given_up = True
        self.abandon(why)
        raise SinkUnavailable(f"broker {self.broker}: {why}; the connection is given up")

    def _check(self, message: Message, reason: ReasonCode | None) -> None:
        if reason is None or not reason.is_failure:
            return
        sentence = f"broker {self.broker} refuses the message on {message.topic}: {reason}"
        if reason.value in _REFUSALS:
            raise SinkRejected(f"{sentence}; check its access rules")
        raise SinkUnavailable(sentence)

    def _lost_sentence(self) -> str:
        return (
            f"the connection to broker {self.broker} is lost ({self.why_lost or 'it closed the connection'})"
        )

    def _await(self, is_done: Callable[[], bool], timeout_s: float) -> None:
        with self._changed:
            self._changed.wait_for(is_done, timeout_s)

    def _lose(self, why: str) -> None:
        with self._changed:
            if self._is_lost:
                return
            self._is_lost = True
            self.why_lost = self.why_lost or why
            self._changed.notify_all()
        # The library closes two sockets of its own with the client, and in a circle of client and connection that would
        # wait for the garbage collector.
        client = self._client
        client.on_connect = client.on_disconnect = client.on_publish = None
        client.on_subscribe = client.on_message = None
        if self._is_established:  # an attempt that failed was reported by its exception
            self._on_lost()

    # Called by the library's thread, which never waits here.

    def _take_consent(self, reason: ReasonCode, properties: Properties | None) -> None:
        with self._changed:
            self._consent = reason
            self._largest_packet = getattr(properties, "MaximumPacketSize", None)
            self._changed.notify_all()

    def _end(self, flags: paho.DisconnectFlags, reason: ReasonCode) -> None:
        if reason.value == _SILENT:
            self.was_given_up = True
            self._lose("it was silent for longer than keepalive_s")
        elif not flags.is_disconnect_packet_from_server:
            self._lose("")  # the library's reason is "Unspecified error"
        elif reason.value == _TAKEN_OVER:
            self.was_taken_over = True
            self._lose(
                f"another client connected with the client id '{self.broker.client_id}'; give each its own"
            )
        else:
            self._lose(str(reason))

    def _note(self, mid: int, reason: ReasonCode | None) -> None:
        with self._changed:
            if mid not in self._unasked:
                self._answers[mid] = reason
            self._unasked.discard(mid)
            self._changed.notify_all()

    def _message(self, message: paho.MQTTMessage) -> None:
        """Hand a message on. An error here would end the library's thread, and the connection would seem up."""
        if self._on_received is None:
            return
        properties = message.properties
        try:
            self._on_received(
                Received(
                    message.topic,
                    bytes(message.payload),
                    message.qos,
                    message.retain,
                    getattr(properties, "ResponseTopic", None),
                    getattr(properties, "CorrelationData", None),
                )
            )
        except Exception:
            log.exception("a message from broker %s failed here, and is left out", self.broker)


@lru_cache(maxsize=16)
def _make_properties(
    packet: int, content_type: str, expiry_s: int | None, correlation: bytes | None
) -> Properties:
    """Make what a message says besides its payload. The library reads it only, and takes long to make it."""
    properties = Properties(packet)  # type: ignore[no-untyped-call]
    if content_type:
        properties.ContentType = content_type
        properties.PayloadFormatIndicator = int(content_type == "application/json")
    if expiry_s is not None:
        properties.MessageExpiryInterval = expiry_s
    if correlation is not None:
        properties.CorrelationData = correlation
    return properties
