"""Brokers, each with a subscriber that keeps everything, and the plugin with which the station talks to them.

mood: `up`; `away`; `silent` (it takes nothing and says nothing); `forgets answers` (it takes a message, and its
acknowledgement is lost); `refuses` (one kind of message); `kicks` (another client has the same id); `is narrow` (it
takes small packets alone); `doubles` and `delays` what its subscriber gets.
"""

import json
import random
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, ClassVar

from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.core.sink_context import Station
from simulation.options import BrokerOptions

if TYPE_CHECKING:
    from simulation.surroundings import SimulatedClock

NARROW_BYTES = 600
"""Less than a picture has, and more than a state."""


class Broker:
    """A broker with one subscriber that keeps everything: what came, in the order in which it came."""

    all: ClassVar[dict[str, "Broker"]] = {}
    """Those of the run that is on, by name."""
    is_dead: ClassVar[Callable[[], bool]] = staticmethod(lambda: False)
    """The process at the other end was killed."""

    def __init__(self, name: str, rng: random.Random, clock: "SimulatedClock") -> None:
        self.name, self._rng, self._clock = name, rng, clock
        self.mood = "up"
        self.refuses = ""
        self.has_refused_results = False
        self.retained: dict[str, bytes] = {}
        self.results: dict[str, list[dict[str, object]]] = {}
        self.order: list[str] = []
        self.pictures: Counter[str] = Counter()
        self.connections = 0
        self.said: Counter[str] = Counter()
        """What went wrong, and how often."""
        self.sessions: list[Session] = []
        self._delayed: list[Message] = []
        self.taken_ns: dict[str, int] = {}
        """When each result was taken at first."""
        self.outages: list[tuple[int, int]] = []
        """From when to when it took nothing."""
        self.away_since_ns: int | None = None
        self.went_back: list[str] = []
        """What an auditor says of retained messages whose press is older than that before."""
        self._numbers: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self.misnamed: list[str] = []
        """Pictures that name another press than their topic."""

    def go(self, mood: str) -> None:
        """Take this mood."""
        self.mood = mood
        self.said[mood] += 1
        if mood in ("away", "silent", "kicks"):
            self.lose_all()
            self.away_since_ns = self._clock.now_ns

    def lose_all(self) -> None:
        """The process at the other end is dead."""
        for session in self.sessions:
            session.lose()
        self.sessions.clear()

    def mend(self) -> None:
        """It is up again, and its subscriber gets what was delayed."""
        self.mood = "up"
        if self.away_since_ns is not None:
            self.outages.append((self.away_since_ns, self._clock.now_ns))
            self.away_since_ns = None
        for message in self._delayed:
            self._hand_over(message)
        self._delayed.clear()

    def take(self, message: Message) -> None:
        """Take a message as a broker does, and hand it to the subscriber."""
        if message.retain:
            self._compare(message)
            self.retained[message.topic] = message.payload
            if not message.payload:
                del self.retained[message.topic]
        if self.mood == "delays" or self._delayed:
            self._delayed.append(message)
            return
        self._hand_over(message)
        if self.mood == "doubles":
            self._hand_over(message)

    def answer(self, message: Message) -> None:
        """Take it, or not, as the mood is. Errors: SinkUnavailable, SinkRejected."""
        kind = message.topic.partition("/")[0]
        if self.mood in ("away", "silent", "kicks"):
            self.said[self.mood] += 1
            raise SinkUnavailable(f"{self.name}: {self.mood}")
        is_refused = self.mood == "refuses" and kind == self.refuses
        if is_refused or (self.mood == "is narrow" and len(message.payload) > NARROW_BYTES):
            self.said["a message refused"] += 1
            self.has_refused_results |= message.topic == "result"
            raise SinkRejected(f"{self.name} refuses {kind}, {len(message.payload)} bytes")
        self.take(message)
        if self.mood == "forgets answers" and self._rng.random() < 0.4:
            self.said["an answer forgotten"] += 1
            raise SinkUnavailable(f"{self.name} did not acknowledge")

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
                self.taken_ns[result["press_id"]] = self._clock.now_ns
                self.order.append(result["press_id"])
            self.results.setdefault(result["press_id"], []).append(result)
        elif kind == "heatmap":
            self.pictures[press_id] += 1
            if message.payload and press_id.encode() not in message.payload:
                self.misnamed.append(press_id)


class Session:
    """A connection of the station to a broker, made again when it was lost. A dead process sends nothing."""

    def __init__(self, broker: Broker, context: Station) -> None:
        self._broker, self.context = broker, context
        self._is_up = False
        broker.sessions.append(self)

    def send(self, message: Message) -> None:
        if Broker.is_dead():
            raise SinkUnavailable("killed")
        try:
            if not self._is_up:
                self._connect()
            self._broker.answer(message)
        except SinkUnavailable:
            self.lose()
            raise

    def close(self) -> None:
        """The station ends in order: its last messages are out, so there is no will."""
        self._is_up = False

    def lose(self) -> None:
        """The connection is lost: the broker publishes the will."""
        if self._is_up and self.context.will is not None:
            self._broker.take(self.context.will)
        self._is_up = False

    def _connect(self) -> None:
        if self._broker.mood in ("away", "silent"):
            self._broker.said[self._broker.mood] += 1
            raise SinkUnavailable(f"{self._broker.name}: {self._broker.mood}")
        self._broker.connections += 1
        self._is_up = True
        for message in self.context.birth():
            with suppress(SinkRejected):  # the others of the birth are said all the same
                self._broker.answer(message)


class BrokerPlugin:
    """A broker of the run."""

    Options = BrokerOptions

    def open(self, options: BrokerOptions, context: Station) -> Session:
        return Session(Broker.all[options.name], context)


broker_plugin = BrokerPlugin()
