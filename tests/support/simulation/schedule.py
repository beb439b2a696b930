"""One run: a schedule that is drawn from a seed steps the station and its surroundings, and auditors watch.

No thread is started and no time is waited for: each thread of the station is an actor whose turn the schedule draws,
and the clock moves to the next actor that has something to do. The same seed and commit give the same run.
"""

import random
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from edge.config import Config, load_config
from simulation.auditors import CALM_S, audit_end, audit_now, audit_replay
from simulation.conditions import reached_at_end
from simulation.faults import ASKING, FAULTS
from simulation.lives import Station
from simulation.outputs import TABLES
from simulation.power import listening
from simulation.surroundings import PERIOD_NS, S, World

CONFIG = """
version = 1
[device]
plugin = "simulated"
[inspection]
threads = 1
part = "PZ0/pos1"
{bundles}
[store]
path = "{folder}/gelgate.db"
{archive}
"""
SINK = '[[sinks]]\nplugin = "simulated"\noptions = {{ name = "{name}" }}\n'


@dataclass
class Chosen:
    """What a seed chooses. Rates are faults per simulated minute."""

    brokers: int
    has_archive: bool
    rates: dict[str, float]
    sloth_s: float
    """The longest wait of a ready actor for its turn."""

    @classmethod
    def of(cls, rng: random.Random) -> "Chosen":
        """Draw: each kind of fault is left out of half of the runs, so that others meet alone."""
        rates = {name: rng.choice((0, 0, 1, 5)) for name in FAULTS}
        return cls(rng.choice((1, 1, 2)), rng.random() < 0.5, rates, rng.choice((0.0, 0.01, 0.03)))


@dataclass
class Actor:
    """A turn of the station or of its surroundings. act: returns the seconds until it is due again."""

    name: str
    act: Callable[[], float]
    due_ns: int = 0


@dataclass
class Run:
    """What a run did: the events in order, what was reached, and what an auditor found."""

    seed: int
    presses: int
    events: list[str] = field(default_factory=list)
    reached: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    turns: int = 0


class Simulation:
    """A station in its world. bundles: of both parts, with the tiny detector. folder: empty, for the disk."""

    def __init__(
        self, seed: int, presses: int, bundles: Sequence[Path], folder: Path, chosen: Chosen | None = None
    ) -> None:
        self.rng = random.Random(seed)
        self.chosen = chosen or Chosen.of(self.rng)
        self.run = Run(seed, presses)
        self.world = World(self.rng, self.chosen.brokers)
        self.world.sensor.most_presses = presses
        self._disk = folder / "disk"
        self._disk.mkdir(parents=True)
        self._config = folder / "gelgate.toml"
        self._bundles, self._order = bundles, list(self.world.brokers)
        self.station = Station(self.world, self._disk, self._read_config)
        self._calm_ns: int | None = None
        self._asked_ns = 0
        self._ending: dict[str, Callable[[], None]] = {}
        self._actors = [Actor("camera", self._camera), *self._threads(), *self._faults()]

    def play(self) -> Run:
        """Play until all presses are made and all is calm; stops at the first thing that must not be."""
        with _drawn_from(self.rng), listening(self._disk) as self.station.disk.unsynced:
            self.station.open()
            try:
                while not self.run.faults and not self._is_over():
                    self._turn()
                if not self.run.faults:
                    self.run.faults += audit_end(self.world, self.station)
                    self.run.faults += audit_replay(self.world, self.station, self._bundles)
                self.run.reached.update(set(reached_at_end(self.world, self.station)))
            finally:
                self.station.close()
        return self.run

    def note(self, event: str) -> None:
        """Note an event with its time."""
        self.run.events.append(f"{self.world.clock.now_ns / S:10.3f} {event}")

    def reach(self, condition: str) -> None:
        """Count a condition that is sometimes so."""
        self.run.reached[condition] += 1

    def reach_here(self, condition: str) -> None:
        """Count it, and whether it came during a press."""
        self.reach(condition + (" during a press" if self.world.sensor.press else ""))

    @property
    def is_broker_away(self) -> bool:
        """A broker does not answer now."""
        return any(broker.mood == "away" for broker in self.world.brokers.values())

    def _turn(self) -> None:
        """Let one of the actors that are due take its turn; where none is, time goes on to the next."""
        clock = self.world.clock
        first = min(actor.due_ns for actor in self._actors)
        clock.now_ns = max(clock.now_ns, first)
        ready = [actor for actor in self._actors if actor.due_ns <= clock.now_ns]
        actor = ready[0] if ready[0].name == "camera" else self.rng.choice(ready)
        self.run.turns += 1
        if actor.name == "camera":
            self.run.faults += audit_now(self.world)
        self.station.disk.attach()
        pause_s = actor.act()
        actor.due_ns = clock.now_ns + round(pause_s * S)
        if self.station.disk.is_dead:
            self._rise()

    def _is_over(self) -> bool:
        """All presses are made, the faults have ended, and all is calm, or should be."""
        if self.world.sensor.is_done and self._calm_ns is None:
            for end in list(self._ending.values()):
                end()
            self._ending.clear()
            self._actors = [actor for actor in self._actors if actor.name not in FAULTS]
            self._calm_ns = self.world.clock.now_ns
        if self._calm_ns is None or self.world.clock.now_ns < self._asked_ns + S:
            return False
        self._asked_ns = self.world.clock.now_ns
        is_late = self._asked_ns > self._calm_ns + CALM_S * S
        return is_late or not list(audit_end(self.world, self.station))

    # The threads of the station

    def _threads(self) -> list[Actor]:
        threads = [Actor("reader", self._read), Actor("loop", self._loop), Actor("pictures", self._draw)]
        threads += [
            Actor("bundles", self._open_bundles),
            Actor("relay", self._switch),
            Actor("pedal", self._tread),
        ]
        names = list(self.world.brokers)
        threads += [Actor(name, lambda name=name: self._publish(name)) for name in names]  # type: ignore[misc]
        self._own = {actor.name for actor in threads}
        return threads

    def freeze(self, seconds: float) -> None:
        """Let no thread of the station take a turn for so long."""
        for actor in self._actors:
            if actor.name in self._own:
                actor.due_ns = self.world.clock.now_ns + round(seconds * S)

    def _camera(self) -> float:
        sensor = self.world.sensor
        before = sensor.press
        sensor.make()
        state = self.station.loop.parts.status.view().state
        if sensor.press and state != "ready":
            sensor.press.why.add(f"the station said '{state}'")
        if sensor.press is not before and sensor.press is not None:
            kind = "dented" if sensor.press.is_dented else "sound"
            self.note(f"press {sensor.press.number} begins, {kind}")
        return (sensor.next_ns - self.world.clock.now_ns) / S

    def _read(self) -> float:
        pause_s = self.station.loop.parts.acquisition.step()
        return pause_s or self._lag(PERIOD_NS / S / 4)

    def _obey(self) -> None:
        """The person at the station reads the alarm, and leaves the gel free for a while."""
        said = self.station.loop.parts.status.view().alarms
        if "contact" in said and not self.world.sensor.press and self.world.sensor.is_pressing_soon:
            self.reach("the hand lifted because the station asked for it")
            self.world.sensor.wait(3)

    def _loop(self) -> float:
        loop = self.station.loop
        self._obey()
        frame = loop.parts.acquisition.next(0)
        if frame is not None:
            self.station.fed_ns.append(frame.timestamp_ns)
        was_halted = loop.is_halted
        loop.step(frame)
        if loop.is_halted != was_halted:
            self.reach("the store refused a press" if loop.is_halted else "the store took what had waited")
            self.note("the store refuses" if loop.is_halted else "the store accepts again")
        return self._lag(PERIOD_NS / S / 3)

    def _draw(self) -> float:
        self.station.loop.parts.pictures.step()
        return 0.1 + self._lag(0.2)

    def _open_bundles(self) -> float:
        self.station.loop.parts.selection.worker.step()
        return 0.1 + self._lag(0.2)

    def _switch(self) -> float:
        (driver,) = self.station.outputs.drivers
        return min(driver.step(), 0.06) + self._lag(0)

    def _tread(self) -> float:
        (reader,) = self.station.outputs.readers
        return (reader.step() or 0.05) + self._lag(0)

    def _publish(self, name: str) -> float:
        workers = self.station.loop.parts.publisher.workers
        worker = list(workers.values())[self._order.index(name)]
        pause_s = worker.step()
        return min(pause_s, 5.0) if not worker.counters.is_up else min(pause_s, 0.15 + self._lag(0.2))

    def _lag(self, least_s: float) -> float:
        return least_s + self.rng.uniform(0, self.chosen.sloth_s)

    # The faults

    def _faults(self) -> Iterator[Actor]:
        for name, act in FAULTS.items():
            if rate := self.chosen.rates[name]:
                yield Actor(
                    name,
                    lambda act=act, rate=rate: self._fault(act, rate),
                    round(self.rng.expovariate(rate / 60) * S),
                )  # type: ignore[misc]

    def _fault(self, act: "Callable[[Simulation], float]", rate: float) -> float:
        if "process frozen" in self._ending and act in ASKING:  # nobody answers
            return 0.1
        lasts_s = act(self)
        return lasts_s + self.rng.expovariate(rate / 60)

    def for_a_while(
        self, name: str, lasts_s: float, end: Callable[[], None], *, is_sensors: bool = False
    ) -> float:
        """Let a fault last; it ends then, or at the end of the run. is_sensors: a press that meets it may be lost."""
        sensor = self.world.sensor
        if is_sensors:
            sensor.troubles.add(name)
            sensor.disturb(name)

        def over() -> None:
            end()
            if is_sensors:
                sensor.disturb(name)
                sensor.troubles.discard(name)
                sensor.dim_until_ns = self.world.clock.now_ns + S
            self.note(f"{name} ends")

        self._ending[name] = over

        def ended() -> float:
            if self._ending.pop(name, None):
                over()
            self._actors = [one for one in self._actors if one is not actor]
            return 0.0

        actor = Actor(f"end of {name}", ended, self.world.clock.now_ns + round(lasts_s * S))
        self._actors.append(actor)
        self.note(f"{name}, for {lasts_s:.1f} s")
        if name.split()[0] not in self.world.brokers:
            self.reach(name) if name.startswith(("relay", "pedal")) else self.reach_here(name)
        return lasts_s

    def _rise(self) -> None:
        """The process is dead: the next one opens what the disk holds."""
        point = self.station.disk.killed_at
        self.note(f"{'the power is lost' if self.station.disk.lost else 'killed'} at {point}")
        self.reach(f"killed at {'a file' if ' ' in point else point}")
        self.reach("killed during a press" if self.world.sensor.press else "killed between presses")
        if self.is_broker_away:
            self.reach("killed while a broker was away")
        if self.station.disk.is_full:
            self.reach("killed while the disk was full")
        self.world.sensor.disturb("the gateway was killed")
        self.station.bury()
        self.open_again()

    def open_again(self) -> None:
        self.station.open()
        for actor in self._actors:
            if actor.name in self._own:
                actor.due_ns = self.world.clock.now_ns

    def _read_config(self) -> Config:
        """Read what a person has written, who gives the brokers another order."""
        before = list(self._order)
        self.rng.shuffle(self._order)
        if self._order != before and self.station.lives > 1:
            self.reach("restarted with the sinks in another order")
        self._config.write_text(_config(self.chosen, self._bundles, self._disk, self._order))
        return load_config(self._config)


@contextmanager
def _drawn_from(rng: random.Random) -> Iterator[None]:
    """A generator that the program makes without a seed gets one from the run."""
    real = random.Random

    class Drawn(real):  # type: ignore[misc, valid-type]
        def __init__(self, seed: object = None) -> None:
            super().__init__(rng.getrandbits(64) if seed is None else seed)

    random.Random = Drawn  # type: ignore[misc]
    try:
        yield
    finally:
        random.Random = real  # type: ignore[misc]


def _config(chosen: Chosen, bundles: Sequence[Path], disk: Path, brokers: Sequence[str]) -> str:
    archive = "" if chosen.has_archive else "[archive]\npresses = 0\n"
    paths = "".join(f'[[inspection.bundles]]\npath = "{path}"\n' for path in bundles)
    text = CONFIG.format(bundles=paths, folder=disk, archive=archive)
    return text + TABLES + "".join(SINK.format(name=name) for name in brokers)
