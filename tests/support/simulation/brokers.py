"""MQTT brokers, each with a subscriber that keeps everything.

mood: `up`; `away`; `silent` (it takes nothing and says nothing); `forgets answers` (it takes a message, and its
acknowledgement is lost); `answers late`; `answers another` (it acknowledges another message); `ignores` or `refuses`
one kind of message; `denies` every connection, or but one (`lets one in`); `kicks` (another client has the same id);
`is narrow` (it takes small packets alone); `doubles` and `delays` what its subscriber gets.
"""

import json
import random
import socket
from collections import Counter, deque
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from edge.core.ports import Message
from simulation.packets import (
    CONNACK,
    CONNECT,
    DISCONNECT,
    NOT_AUTHORIZED,
    OTHER_LEVEL,
    PINGREQ,
    PINGRESP,
    PUBLISH,
    SUBSCRIBE,
    TAKEN_OVER,
    TOO_LARGE,
    Publish,
    connack,
    packet,
    puback,
    publish,
    read_connect,
    read_publish,
    suback,
    take_packets,
)

if TYPE_CHECKING:
    from simulation.surroundings import SimulatedClock

S = 10**9
NARROW_BYTES = 900
"""Less than a picture has, and more than a state."""
SAVED_S = 20.0
"""How often it writes on its disk what it retains."""
WELL_S = 3.0
"""What was sent to a broker that hung has come so long after it goes on."""
TAKES_NOTHING = ("away", "silent", "kicks", "denies")
CUTS = ("away", "kicks", "denies", "is narrow", "lets one in")
"""Moods that begin with the end of every connection."""


@dataclass(frozen=True)
class Told:
    """What a robot that subscribes was told of the contact by a station that is ready, and when."""

    at_ns: int
    state: str
    press_id: str | None
    is_at_once: bool
    """The broker has been well for a while, and hands over what comes."""


@dataclass
class Link:
    """A connection of the station, at the broker's end."""

    sock: socket.socket
    level: str = "5"
    client_id: str = ""
    will: Message | None = None
    is_subscribed: bool = False
    expiry_s: float = 0.0
    """So long after its end the session is kept."""
    data: bytearray = field(default_factory=bytearray)
    answers: deque[tuple[int, bytes]] = field(default_factory=deque)
    """When each is sent."""
    is_over: bool = False

    @property
    def is_second(self) -> bool:
        """It only holds the will of `availability`."""
        return self.client_id.endswith("-availability")


@dataclass
class Session:
    """What a broker keeps of a client that is away. waiting: what was sent to it meanwhile."""

    level: str
    until_ns: float
    waiting: list[bytes] = field(default_factory=list)


class Broker:
    """A broker with one subscriber that keeps everything: what came, in the order in which it came.

    level: the one that it speaks best. `silent at 5` knows 3.1.1 alone, and does not say so.
    """

    def __init__(self, name: str, rng: random.Random, clock: "SimulatedClock", level: str) -> None:
        self.name, self._rng, self._clock, self.level = name, rng, clock, level
        self.mood = "up"
        self.root = ""
        self.chosen_kind = ""
        """What it refuses or ignores."""
        self.has_refused_results = False
        self.refused: dict[str, int] = {}
        """What it has refused at level 5 in this connection and not taken since, and when."""
        self.retained: dict[str, bytes] = {}
        self.saved: dict[str, bytes] = {}
        """What it retained when it last wrote that."""
        self.saved_ns = 0
        self.stale = set[str]()
        """Topics on which it retains what is older since it crashed, and nothing has come."""
        self.sessions: dict[str, Session] = {}
        """Of clients that are away and have subscribed, by client id."""
        self.results: dict[str, list[dict[str, object]]] = {}
        self.pieces: dict[str, list[dict[str, object]]] = {}
        self.order: list[str] = []
        self.contact: Told | None = None
        """The newest; and the first `lift` of each press."""
        self.lifts: dict[str | None, Told] = {}
        self.well_since_ns = 0
        self.pictures: Counter[str] = Counter()
        self.said: Counter[str] = Counter()
        """What went wrong, and how often."""
        self.links: list[Link] = []
        self._delayed: list[Message] = []
        self.sent_ns: dict[str, int] = {}
        """When each result was sent at first; one that hangs reads it later."""
        self.outages: list[tuple[int, int]] = []
        """From when to when it took nothing."""
        self.away_since_ns: int | None = None
        self.went_back: list[str] = []
        """What an auditor says of retained messages whose press is older than that before."""
        self._numbers: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self.misnamed: list[str] = []
        """Pictures that name another press than their topic."""
        self.connects: list[tuple[str, bool, bool]] = []
        """Each CONNECT of the first connection: its level, whether it has a will, whether it was accepted."""
        self.responses: list[tuple[str, dict[str, object]]] = []
        """Answers to requests, with their verbs."""

    def go(self, mood: str) -> None:
        """Take this mood. A station keeps to the limit of its connection, so that ends with a narrow mood."""
        was_narrow, self.mood = self.mood == "is narrow", mood
        self.said[mood] += 1
        # A station at level 5 knows the limit, and sends no result at all.
        self.has_refused_results |= mood == "is narrow"
        if mood in CUTS or was_narrow:
            self._cut()
        if mood in TAKES_NOTHING:
            self.away_since_ns = self._clock.now_ns

    def mend(self) -> None:
        """It is up again, and its subscriber gets what was delayed."""
        if self.mood == "is narrow":
            self._cut()
        self.mood, self.well_since_ns = "up", self._clock.now_ns
        if self.away_since_ns is not None:
            self.outages.append((self.away_since_ns, self._clock.now_ns))
            self.away_since_ns = None
        for message in self._delayed:
            self._hand_over(message)
        self._delayed.clear()

    def crash(self) -> None:
        """It ends at once: no will is published, no session kept, and it retains what it had last written."""
        for link in self.links:
            self.stale |= set() if link.will is None else {link.will.topic.removeprefix(f"{self.root}/")}
            link.will, link.expiry_s = None, 0.0
        self.sessions.clear()
        topics = self.retained.keys() | self.saved.keys()
        self.stale |= {topic for topic in topics if self.retained.get(topic) != self.saved.get(topic)}
        self.retained = dict(self.saved)

    def close(self) -> None:
        """The run is over."""
        for link in self.links:
            link.sock.close()

    def accept(self, sock: socket.socket) -> None:
        """Take a connection."""
        sock.setblocking(False)
        self.links.append(Link(sock))

    def ask(self, verb: str, payload: bytes, response_topic: str | None = None) -> bool:
        """Send a request to the station; returns whether it listens. One that is away finds it in its session."""
        links = [link for link in self.links if link.is_subscribed and not link.is_over]
        for kept in () if links else self.sessions.values():
            kept.waiting.append(publish(kept.level, f"{self.root}/cmd/{verb}", payload, response_topic))
        for link in links[-1:]:
            link.answers.append(
                (
                    self._clock.now_ns,
                    publish(link.level, f"{self.root}/cmd/{verb}", payload, response_topic),
                )
            )
        return bool(links)

    @property
    def next_ns(self) -> int:
        """When it sends something."""
        dues = (link.answers[0][0] for link in self.links if link.answers)
        return min(dues, default=1 << 62) if self.mood != "silent" else 1 << 62

    def work(self) -> None:
        """Do what has come, and send what is due."""
        if self.mood == "silent":
            return
        if self._clock.now_ns - self.saved_ns > SAVED_S * S:
            self.saved, self.saved_ns = dict(self.retained), self._clock.now_ns
        for link in list(self.links):
            self._read(link)
            while not link.is_over and link.answers and link.answers[0][0] <= self._clock.now_ns:
                self._send(link, link.answers.popleft()[1])
        self.links = [link for link in self.links if not link.is_over]

    def _read(self, link: Link) -> None:
        while not link.is_over:
            try:
                data = link.sock.recv(1 << 16)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            link.data += data
            for first, body in take_packets(link.data):
                self._take_packet(link, first, body)
                if link.is_over:
                    return
            if not data:
                self._lose(link)

    def _take_packet(self, link: Link, first: int, body: bytes) -> None:
        kind = first >> 4
        if kind == CONNECT:
            self._connect(link, body)
        elif kind == PUBLISH:
            self._answer(link, read_publish(first, body, link.level), len(body))
        elif kind == SUBSCRIBE:
            link.is_subscribed = True
            self._send(link, suback(link.level, body))
        elif kind == PINGREQ:
            self._send(link, packet(PINGRESP))
        elif kind == DISCONNECT:
            link.will = None
            self._lose(link)

    def _connect(self, link: Link, body: bytes) -> None:
        said = read_connect(body)
        link.level, link.client_id = said.level, said.client_id
        is_denied = self.mood == "denies" or (self.mood == "lets one in" and link.is_second)
        is_wrong = said.level == "5" and self.level != "5"
        if not (link.is_second or link.client_id.endswith("-level")):
            self.connects.append((said.level, said.will is not None, not (is_denied or is_wrong)))
        if is_wrong and self.level == "silent at 5":
            return
        if is_wrong or is_denied:
            code = OTHER_LEVEL if is_wrong else NOT_AUTHORIZED
            self.said["a connection refused"] += 1
            self._send(link, packet(CONNACK, b"\0\1") if is_wrong else connack(link.level, code))
            self._lose(link)
            return
        for other in self.links:
            if other is not link and other.client_id == link.client_id:
                self._kick(other)
        link.will, link.expiry_s = said.will, said.expiry_s
        kept = self.sessions.pop(link.client_id, None)
        link.is_subscribed = bool(kept and kept.until_ns > self._clock.now_ns and not said.is_clean)
        largest = NARROW_BYTES if self.mood == "is narrow" else None
        self._send(link, connack(link.level, 0, largest, is_kept=link.is_subscribed))
        if kept is not None and link.is_subscribed:
            link.answers += [(self._clock.now_ns, sent) for sent in kept.waiting]
        if self.mood == "kicks" and not link.is_second:
            self._kick(link)

    def _answer(self, link: Link, sent: Publish, size: int) -> None:
        """Take a message, or not, as the mood is."""
        topic = sent.message.topic.removeprefix(f"{self.root}/")
        kind, is_kind = topic.partition("/")[0], topic.partition("/")[0] == self.chosen_kind
        is_large = self.mood == "is narrow" and size > NARROW_BYTES
        if (self.mood == "refuses" and is_kind) or is_large:
            self.said["a message refused"] += 1
            self.has_refused_results |= kind == "result"
            if link.level == "5" and not is_large:
                self.refused.setdefault(_name(topic, sent.message.payload), self._clock.now_ns)
                self._send(link, puback("5", sent.number, NOT_AUTHORIZED))
                return
            if link.level == "5":
                self._send(link, packet(DISCONNECT, bytes([TOO_LARGE])))
            self._lose(link)
            return
        if self.mood == "ignores" and is_kind:
            self.said["a message ignored"] += 1
            return
        number, is_taken = sent.number, True
        if self.mood == "answers another" and sent.message.qos and self._rng.random() < 0.4:
            self.said["another message acknowledged"] += 1
            # What it says of another one says nothing of this one.
            number, is_taken = sent.number % 65_000 + 1, self._rng.random() < 0.5
        if is_taken:
            self.take(Message(topic, sent.message.payload, sent.message.qos, sent.message.retain))
        if not sent.message.qos:
            return
        if self.mood == "forgets answers" and self._rng.random() < 0.4:
            self.said["an answer forgotten"] += 1
            return
        late_s = self._rng.choice((0.05, 0.4, 2.0, 11.0)) if self.mood == "answers late" else 0.0
        link.answers.append((self._clock.now_ns + round(late_s * S), puback(link.level, number)))

    def take(self, message: Message) -> None:
        """Take a message as a broker does, and hand it to the subscriber."""
        if self.refused:
            self.refused.pop(_name(message.topic, message.payload), None)
        if message.retain:
            self._compare(message)
            self.stale.discard(message.topic)
            self.retained[message.topic] = message.payload
            if not message.payload:
                del self.retained[message.topic]
        if self.mood == "delays" or self._delayed:
            self._delayed.append(message)
            return
        self._hand_over(message)
        if self.mood == "doubles":
            self._hand_over(message)

    def _kick(self, link: Link) -> None:
        if link.level == "5":
            self._send(link, packet(DISCONNECT, bytes([TAKEN_OVER])))
        self._lose(link)

    def _cut(self) -> None:
        """Every connection ends, with what is not read yet."""
        for link in self.links:
            self._lose(link)
        self.links.clear()

    def _lose(self, link: Link) -> None:
        """A connection ends: where it did not say so, its will is published."""
        if link.is_over:
            return
        link.is_over = True
        link.sock.close()
        if not link.is_second:
            self.refused.clear()
        if link.expiry_s and link.is_subscribed:
            self.sessions[link.client_id] = Session(link.level, self._clock.now_ns + link.expiry_s * S)
        if link.will is not None:
            will = link.will
            self.take(Message(will.topic.removeprefix(f"{self.root}/"), will.payload, will.qos, will.retain))

    def _send(self, link: Link, data: bytes) -> None:
        with suppress(OSError):  # nobody is there any more, which is read in a moment
            link.sock.send(data)

    def _compare(self, message: Message) -> None:
        """The retained press and the count of a gel never go back (docs/mqtt.md)."""
        if message.topic not in ("last/press", "gel") or not message.payload:
            return
        said = json.loads(message.payload)
        key = f"{message.topic} {said['gel_id'] if message.topic == 'gel' else ''}"
        number = said["presses"] if message.topic == "gel" else self._order_of(said["press_id"])
        if number < self._numbers.get(key, 0):
            self.went_back.append(f"{self.name}: what is retained on {message.topic} went back")
        self._numbers[key] = number

    def _order_of(self, press_id: str) -> int:
        return self._seen.setdefault(press_id, len(self._seen))

    def _hand_over(self, message: Message) -> None:
        kind, _, press_id = message.topic.partition("/")
        if message.topic == "result":
            result = json.loads(message.payload)
            if result["press_id"] not in self.results:
                self.order.append(result["press_id"])
            self.results.setdefault(result["press_id"], []).append(result)
        elif message.topic == "piece_result":
            piece = json.loads(message.payload)
            self.pieces.setdefault(piece["piece_id"], []).append(piece)
        elif message.topic == "contact" and message.payload:
            self._tell_robot(json.loads(message.payload))
        elif kind == "heatmap":
            self.pictures[press_id] += 1
            if message.payload and press_id.encode() not in message.payload:
                self.misnamed.append(press_id)
        elif kind == "cmd":
            self.responses.append((press_id, json.loads(message.payload)))

    @property
    def is_connected(self) -> bool:
        """It has the first connection: one that it has just ended may not be missed yet."""
        return any(not (link.is_second or link.is_over) and link.will is not None for link in self.links)

    @property
    def is_well(self) -> bool:
        """It has been up for a while: what hung is over."""
        return self.mood == "up" and self._clock.now_ns - self.well_since_ns > WELL_S * S

    @property
    def says_ready(self) -> bool:
        """What it retains of the station is `ready`."""
        return bool(json.loads(self.retained.get("state", b"{}")).get("state") == "ready")

    def _tell_robot(self, said: dict[str, object]) -> None:
        """A robot takes nothing from a station that is not ready (docs/contact.md)."""
        if not self.says_ready:
            self.contact = None
            return
        press_id = None if said["press_id"] is None else str(said["press_id"])
        told = Told(self._clock.now_ns, str(said["state"]), press_id, self.is_well)
        self.contact = told
        if told.state == "lift":
            self.lifts.setdefault(press_id, told)


def _name(topic: str, payload: bytes) -> str:
    """Name a message, also where it is sent again later."""
    return f"result {json.loads(payload)['press_id']}" if topic == "result" else topic
