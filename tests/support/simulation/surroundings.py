"""What surrounds a station, each with a state of its own: clock, sensor with the hand that presses, and brokers.

The sensor and the brokers are plugins of a package that is installed for the run, so the station opens them as it opens
any other.
"""

import json
import random
import sys
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import BaseModel
from station import gel, jpeg

from edge import registry
from edge.core.errors import (
    DeviceLost,
    DeviceNotFound,
    DeviceStalled,
    FrameCorrupt,
    SinkRejected,
    SinkUnavailable,
)
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Clock, DeviceIdentity, DiscoveredDevice, Message
from edge.core.sink_context import Station
from simulation.outputs import Pedal, Relay

S = 10**9
PERIOD_NS = round(S / 18.75)
NOTICED_S = 0.25
"""A contact is a press so long after its begin at most."""
SERIAL = "SIM00001"
IDENTITY = DeviceIdentity("GelSight Mini R0B SIM0-0001", SERIAL, (320, 240), 18.75)


class SimulatedClock:
    """The station's time. The wall clock is another one: a person, or a time server, may step it."""

    def __init__(self) -> None:
        self.now_ns = S
        self.wall_ns = 1_780_000_000 * S

    def monotonic_ns(self) -> int:
        return self.now_ns

    def time_ns(self) -> int:
        return self.wall_ns + self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * S)


@dataclass
class MadePress:
    """A press of the hand. why: the faults while it was made or recorded; with one it may be lost, never doubled."""

    number: int
    begin_ns: int
    is_dented: bool
    end_ns: int = 0
    gel: int = 0
    why: set[str] = field(default_factory=set)


@cache
def _pictures(kind: str) -> Sequence[bytes]:
    """JPEGs of one phase, each with other noise."""
    depth = {"free": 0.0, "near": 0.5, "sound": 1.0, "dented": 1.0, "leaving": 0.3}[kind]
    rng = np.random.default_rng(len(kind))
    return tuple(jpeg(gel(rng, depth, kind == "dented")) for _ in range(12))


class Sensor:
    """A sensor on USB, and the hand that presses parts on it. It makes a frame each period, whether it is read or not.

    The driver keeps four frames, as those of cameras do: the oldest or the newest.
    """

    KEPT = 4

    def __init__(self, rng: random.Random, clock: SimulatedClock) -> None:
        self._rng, self._clock = rng, clock
        self.is_plugged = True
        self.is_silent = False
        self.corrupt_share = 0.0
        self.troubles: set[str] = set()
        """Faults of now: a press that meets one may be lost."""
        self.dim_until_ns = 0
        """Until then a press may count as one with that before the interruption (docs/contact.md)."""
        self.presses: list[MadePress] = []
        self.openings = 0
        self.keeps_oldest = rng.random() < 0.5
        """Of frames that nobody reads; otherwise the newest."""
        self.next_ns = clock.now_ns
        self.most_presses = 0
        self._made = 0
        self._phases: deque[str] = deque(["free"] * 40)
        self._kept: deque[tuple[bytes, int]] = deque()

    @property
    def press(self) -> MadePress | None:
        """The press that is made now."""
        return self.presses[-1] if self.presses and not self.presses[-1].end_ns else None

    @property
    def is_done(self) -> bool:
        """All presses are made, and the gel is free."""
        return len(self.presses) >= self.most_presses and self.press is None

    def make(self) -> None:
        """The camera makes a frame of what is on the gel now."""
        kind = self._phase()
        made_ns, self.next_ns = self.next_ns, self.next_ns + PERIOD_NS
        if self.press:
            self.press.why |= self.troubles
            if self.press.begin_ns < self.dim_until_ns:
                self.press.why.add("it began just after an interruption")
        if not self.is_plugged or self.is_silent:
            return
        picture = self._rng.choice(_pictures(kind))
        self._made += 1
        comment = b"\xff\xfe" + (10).to_bytes(2, "big") + self._made.to_bytes(8, "big")
        self._kept.append((picture[:2] + comment + picture[2:], made_ns))
        if len(self._kept) > self.KEPT:
            self._kept.pop() if self.keeps_oldest else self._kept.popleft()
            self.disturb("frames were dropped")

    @property
    def is_pressing_soon(self) -> bool:
        """The gel is free, and not for long."""
        return len(self._phases) < 8

    def take(self) -> tuple[bytes, int] | None:
        """Take the oldest frame."""
        return self._kept.popleft() if self._kept else None

    def forget(self) -> None:
        """What waits is lost: the sensor was unplugged, or is opened anew."""
        self._kept.clear()

    def wait(self, seconds: float) -> None:
        """The hand leaves the gel free for this long, from the end of its press on."""
        self._phases.extend(["free"] * round(seconds * S / PERIOD_NS))

    def disturb(self, why: str, after_s: float = 2.5) -> None:
        """Note a fault with the presses of now: those made until a while ago, whose result may be under way."""
        for press in reversed(self.presses[-8:]):
            if not press.end_ns or self._clock.now_ns - press.end_ns < after_s * S:
                press.why.add(why)

    def _phase(self) -> str:
        if not self._phases:
            self._begin()
        kind = self._phases.popleft()
        press = self.press
        if press and kind == "free":
            press.end_ns = self._clock.now_ns
        return kind

    def _begin(self) -> None:
        if len(self.presses) >= self.most_presses:
            self._phases.append("free")
            return
        is_dented = self._rng.random() < 0.2
        self.presses.append(MadePress(len(self.presses), self._clock.now_ns, is_dented))
        hold = ["dented" if is_dented else "sound"] * self._rng.randint(8, 14)
        self._phases.extend(["near", *hold, "leaving", *["free"] * self._rng.randint(6, 14)])


class OpenSensor:
    """An opening of the sensor, as the station reads it."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._sequence = 0
        self._opening = sensor.openings = sensor.openings + 1
        sensor.forget()
        sensor.dim_until_ns = max(sensor.dim_until_ns, sensor._clock.now_ns + S)

    @property
    def identity(self) -> DeviceIdentity:
        return IDENTITY

    def read(self, deadline_ns: int) -> CameraFrame:
        """Return the oldest frame; it waits for none, for the schedule does."""
        if not self._sensor.is_plugged or self._sensor.openings != self._opening:
            raise DeviceLost("the sensor was unplugged")
        taken = self._sensor.take()
        if taken is None:
            raise DeviceStalled("no frame yet")
        self._sequence += 1
        payload, made_ns = taken
        if self._sensor.corrupt_share and self._sensor._rng.random() < self._sensor.corrupt_share:
            self._sensor.disturb("a frame was corrupt")
            raise FrameCorrupt("a frame ends in the middle")
        return CameraFrame(payload, made_ns, self._sequence)

    def close(self) -> None:
        """Nothing is held."""


class Broker:
    """A broker with one subscriber that keeps everything: what came, in the order in which it came.

    mood: `up`, `away`, `forgets answers` (it takes a message, and its acknowledgement is lost), `refuses` (one kind).
    """

    def __init__(self, name: str, rng: random.Random) -> None:
        self.name, self._rng = name, rng
        self.mood = "up"
        self.refuses = ""
        self.has_refused_results = False
        self.taken: list[tuple[str, bytes]] = []
        self.retained: dict[str, bytes] = {}
        self.results: dict[str, list[dict[str, object]]] = {}
        self.order: list[str] = []
        self.pictures: Counter[str] = Counter()
        self.connections = 0
        self.sessions: list[Session] = []

    def lose_all(self) -> None:
        """The process at the other end is dead."""
        for session in self.sessions:
            session.lose()
        self.sessions.clear()

    def take(self, message: Message) -> None:
        """Take a message as a broker does, and hand it to the subscriber."""
        if message.retain:
            self.retained[message.topic] = message.payload
            if not message.payload:
                del self.retained[message.topic]
        kind, _, press_id = message.topic.partition("/")
        if message.topic == "result":
            result = json.loads(message.payload)
            if result["press_id"] not in self.results:
                self.order.append(result["press_id"])
            self.results.setdefault(result["press_id"], []).append(result)
        elif kind == "heatmap":
            self.pictures[press_id] += 1

    def answer(self, message: Message) -> None:
        """Take it, or not, as the mood is. Errors: SinkUnavailable, SinkRejected."""
        if self.mood == "away":
            raise SinkUnavailable(f"{self.name} is away")
        if self.mood == "refuses" and message.topic.partition("/")[0] == self.refuses:
            self.has_refused_results |= message.topic == "result"
            raise SinkRejected(f"{self.name} refuses {self.refuses}")
        self.take(message)
        if self.mood == "forgets answers" and self._rng.random() < 0.4:
            raise SinkUnavailable(f"{self.name} did not acknowledge")


class Session:
    """A connection of the station to a broker, made again when it was lost. A dead process sends nothing."""

    def __init__(self, broker: Broker, context: Station, is_dead: Callable[[], bool]) -> None:
        self._broker, self._context, self._is_dead = broker, context, is_dead
        self._is_up = False
        broker.sessions.append(self)

    def send(self, message: Message) -> None:
        if self._is_dead():
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
        if self._is_up and self._context.will is not None:
            self._broker.take(self._context.will)
        self._is_up = False

    def _connect(self) -> None:
        if self._broker.mood == "away":
            raise SinkUnavailable(f"{self._broker.name} is away")
        self._broker.connections += 1
        self._is_up = True
        for message in self._context.birth():
            with suppress(SinkRejected):  # the others of the birth are said all the same
                self._broker.answer(message)


PARTS = ("PZ0", "PZ1")


class Selected:
    """What a person has selected or mounted, and when: the truth about each press."""

    def __init__(self, first: str) -> None:
        self.wanted = first
        self._changes: list[tuple[int, str | None]] = [(0, first)]

    def select(self, now_ns: int, part: str) -> None:
        """Take a selection that the station has confirmed."""
        self.wanted = part
        self._changes.append((now_ns, part))

    def forget(self, now_ns: int) -> None:
        """A selection that waits may be lost: a restart, or a disk without room."""
        self._changes.append((now_ns, None))

    def allows(self, press: MadePress, name: str) -> bool:
        """Tell whether a press may be of this: what was selected at its begin, which is noticed a moment later."""
        before = [part for when, part in self._changes if when <= press.begin_ns][-1]
        soon = [part for when, part in self._changes if 0 < when - press.begin_ns < NOTICED_S * S]
        return None in (before, *soon) or name in (before, *soon)


class World:
    """The surroundings of the run that is on; the plugins find them here."""

    now: ClassVar["World"]

    def __init__(self, rng: random.Random, brokers: int) -> None:
        self.clock = SimulatedClock()
        self.sensor = Sensor(rng, self.clock)
        self.brokers = {f"broker{number}": Broker(f"broker{number}", rng) for number in range(brokers)}
        self.is_dead = lambda: False
        self.parts, self.gels = Selected(PARTS[0]), Selected(f"{SERIAL}-1")
        self.relay = Relay.now = Relay(self.clock, lambda: self.is_dead())
        self.pedal = Pedal.now = Pedal(self.clock)
        World.now = self


class Options(BaseModel):
    """Options of both plugins."""

    name: str = ""

    def identity(self) -> str:
        return self.name


class SensorPlugin:
    """The sensor of the run."""

    Options = Options

    def discover(self, options: Options) -> Sequence[DiscoveredDevice]:
        is_there = World.now.sensor.is_plugged
        return [DiscoveredDevice("simulated", IDENTITY.product, IDENTITY)] if is_there else []

    def open(self, options: Options, clock: Clock) -> OpenSensor:
        if not World.now.sensor.is_plugged:
            raise DeviceNotFound("no sensor is plugged in")
        return OpenSensor(World.now.sensor)


class BrokerPlugin:
    """A broker of the run."""

    Options = Options

    def open(self, options: Options, context: Station) -> Session:
        return Session(World.now.brokers[options.name], context, World.now.is_dead)


sensor_plugin, broker_plugin = SensorPlugin(), BrokerPlugin()


def install_plugins(folder: Path) -> Iterator[None]:
    """Install the package of both plugins for a run."""
    info = folder / "simulated-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: simulated\nVersion: 1\n")
    places = {
        "devices": f"{__name__}:sensor_plugin",
        "sinks": f"{__name__}:broker_plugin",
        "triggers": "simulation.outputs:pedal_plugin",
        "actuators": "simulation.outputs:relay_plugin",
    }
    lines = (f"[gelgate.{group}]\nsimulated = {place}\n" for group, place in places.items())
    (info / "entry_points.txt").write_text("".join(lines))
    sys.path.insert(0, str(folder))
    registry._points.cache_clear()
    yield
    sys.path.remove(str(folder))
    registry._points.cache_clear()
