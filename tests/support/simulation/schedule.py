"""One run: a schedule steps the station and its surroundings, and auditors watch.

No time is waited for, and no thread is started but for a request: each is an actor whose turn the schedule draws,
and the clock moves to the next actor that has something to do. The same seed and commit give the same run.
"""

import os
import random
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from traceback import extract_tb, format_exception
from types import SimpleNamespace

from edge.config import Config, load_config
from edge.core.errors import BundleError, ConfigError, StoreError
from simulation.alarms_of_features import WITHIN_S
from simulation.asked import TABLE as MASTER_TABLE
from simulation.auditors import CALM_S, audit_end, audit_now, audit_replay
from simulation.auditors_outbox import ARCHIVED
from simulation.auditors_page import audit_guesses, audit_page
from simulation.auditors_pieces import audit_pieces
from simulation.auditors_retained import audit_retained
from simulation.chosen import AGAIN, MET, OVERVIEW, REFERENCE, TURN_S, Chosen, Fault
from simulation.conditions import reached_at_end
from simulation.connections import connecting
from simulation.disk import Disk
from simulation.faults import FAULTS, NEEDS_ANSWER, NEEDS_DISK
from simulation.lives import Station
from simulation.moments import MOMENTS, WAIT_FIRST, is_held_up
from simulation.options import MESSAGES, SECRET
from simulation.outputs import TABLES
from simulation.overview_camera import TABLE as OVERVIEW_TABLE
from simulation.pieces import PIECE
from simulation.plc import HANDSHAKE, TIMEOUT_S
from simulation.power import listening
from simulation.sensor import SERIAL, S
from simulation.shelf import Shelf
from simulation.surroundings import SimulatedClock, World, reading_log
from simulation.threads import Actor, Threads
from simulation.web import PAGE, TOKEN, Browser

CONFIG = """
version = 1
[device]
plugin = "simulated"
{sensor}
[inspection]
threads = 1
part = "PZ0/pos1"
trigger = "{trigger}"
shadows = {shadows}
{again}
{bundles}
[gel]
limit_presses = 8
[store]
path = "{folder}/gelgate.db"
[commands]
unsigned = ["trigger", "acknowledge_alarm"]
signed = [
  "select_part", "replace_gel", "reload", "relearn", "self_test", "begin_piece", "confirm_press", "adopt_shadow",
  "restore_bundle",
  {more}
]
secret_file = "{secret}"
{archive}
"""
RECORDED_S = 3
"""So long after its end the last press is recorded."""
PATIENCE = 0.99
"""Of a fault that waits for its moment, each tenth of a second."""
BROKERS_S = 0.8
"""So long after its begin a station has seen its sensor, and recorded no press."""
SINK = '[[sinks]]\nplugin = "simulated"\noptions = {{ host = "{name}" }}\n'

FILE = '[[sinks]]\nplugin = "jsonl"\noptions = {{ folder = "{folder}" }}\n'


@dataclass
class Run:
    """What a run did: the events and faults in order, what was reached, and what an auditor found."""

    seed: int
    presses: int
    chosen: Chosen
    events: list[str] = field(default_factory=list)
    schedule: list[Fault] = field(default_factory=list)
    reached: Counter[str] = field(default_factory=Counter)
    counted: Counter[str] = field(default_factory=Counter)
    """Each thing that happened, and how often, for the table."""
    faults: list[str] = field(default_factory=list)
    turns: int = 0


class Simulation:
    """A station in its world. presses: 0 draws how many. bundles: of both parts, with the tiny detector. folder: empty,
    for the disk.

    schedule: the faults; by default they are drawn.
    """

    def __init__(
        self,
        seed: int,
        presses: int,
        bundles: Sequence[Path],
        folder: Path,
        chosen: Chosen | None = None,
        schedule: Sequence[Fault] | None = None,
    ) -> None:
        self.chosen = chosen or Chosen.of(seed, list(FAULTS))
        self.rng = random.Random(f"{seed} turns")
        presses = presses or self.chosen.presses
        self.run = Run(seed, presses, self.chosen)
        self.world = World(seed, self.chosen)
        self.world.hand.most_presses = presses
        self._disk = folder / "disk"
        self._disk.mkdir(parents=True)
        self._config, self._secret = folder / "gelgate.toml", folder / "commands.key"
        self._token = folder / "page.token"
        for file, content in ((self._secret, SECRET), (self._token, TOKEN)):
            file.write_text(content)
            file.chmod(0o600)
        given = {"has_free_view": self.chosen.has_free_view, "has_promise": self.chosen.has_heir}
        self.world.shelf = Shelf(folder / "bundles", bundles, **given)
        self._bundles, self.order = self.world.shelf.paths, list(self.world.brokers)
        self.station = Station(self.world, self._disk, self._begin_config, self._read_config)
        self.browser = Browser(self, random.Random(f"{seed} browser"))
        self._calm_ns: int | None = None
        self._asked_ns = 0
        self.ending: dict[str, Callable[[], None]] = {}
        self._aimed = {name for name in MOMENTS if name in WAIT_FIRST or self.rng.random() < 0.5}
        """Faults that wait for their moment, the next time."""
        self._threads = Threads(self)
        faults = self._drawn_faults(seed) if schedule is None else self._given_faults(schedule)
        self._actors = [*self._threads.all, *faults]
        names = {fault.name for fault in schedule} if schedule is not None else self.chosen.faults
        self._needs_disk = bool(names & NEEDS_DISK)

    def play(self) -> Run:
        """Play until all presses are made and all is calm; stops at the first thing that must not be."""
        disk = listening(self._disk) if self._needs_disk else nullcontext()
        with (
            reading_log(self.run.faults),
            _standing_in(self.rng, self.run.seed, self.world.clock, self.station.disk),
            connecting(self.world.connections),
            disk as self.station.disk.unsynced,
        ):
            try:
                self._play()
            except Exception as error:  # noqa: BLE001 - a program, or an auditor, that ends has failed too
                place = extract_tb(error.__traceback__)[-1]
                self.run.faults.append(f"{place.name} of {Path(place.filename).name} ended it: {error!r}")
                self.run.events += format_exception(error)
        return self.run

    def _play(self) -> None:
        try:
            self.station.open()
            while not self.run.faults and not self._is_over():
                self._turn()
            if not self.run.faults:
                self.run.faults += audit_end(self.world, self.station)
                self.run.faults += audit_guesses(self.station, self.browser)
                self.run.faults += audit_replay(self.world, self.station, self.world.shelf.replayed)
            self.run.reached.update(set(reached_at_end(self.world, self.station)))
            self.run.counted["presses"] += len(self.world.hand.presses)
            for broker in self.world.brokers.values():
                self.run.counted["faults of brokers"] += broker.said.total()
        finally:
            self.station.close()

    def freeze(self, seconds: float) -> None:
        """Let no thread of the station take a turn for so long."""
        self._threads.freeze(seconds)

    def note(self, event: str) -> None:
        """Note an event with its time."""
        self.run.events.append(f"{self.world.clock.now_ns / S:10.3f} {event}")

    def reach(self, condition: str) -> None:
        """Count a condition that is sometimes so."""
        self.run.reached[condition] += 1

    def reach_here(self, condition: str) -> None:
        """Count it, and whether it came during a press."""
        self.reach(condition + (" during a press" if self.world.hand.press else ""))

    @property
    def is_broker_away(self) -> bool:
        """A broker does not answer now."""
        return any(broker.mood in ("away", "silent") for broker in self.world.brokers.values())

    def _turn(self) -> None:
        """Let one of the actors that are due take its turn; where none is, time goes on to the next."""
        clock, camera = self.world.clock, self._threads.camera
        now_ns = clock.now_ns = max(clock.now_ns, min([actor.due_ns for actor in self._actors]))
        if camera.due_ns <= now_ns:
            actor = camera
            self.run.faults += audit_now(self.world, self.station)
            self.run.faults += audit_page(self.world, self.station, self.browser)
        else:
            ready = [actor for actor in self._actors if actor.due_ns <= now_ns]
            actor = ready[0] if len(ready) == 1 else self.rng.choice(ready)
        self.run.turns += 1
        self.station.disk.attach()
        pause_s = actor.act()
        self.station.watch_late()
        actor.due_ns = clock.now_ns + round(pause_s * S)
        if self.station.disk.is_dead:
            self._rise()

    def _is_over(self) -> bool:
        """All presses are made, the faults have ended, and all is calm, or should be."""
        if self.world.hand.is_done and self._calm_ns is None:
            for end in list(self.ending.values()):
                end()
            self.ending.clear()
            self._actors = [actor for actor in self._actors if not actor.name.startswith("fault ")]
            self.station.disk.kill_in = self.station.hangs_in = None
            for broker in self.world.brokers.values() if self.chosen.forgets else ():
                broker.go("away")
                broker.retained.clear()
                broker.mend()
            self._calm_ns = self.world.clock.now_ns
        if self._calm_ns is None or self.world.clock.now_ns < self._asked_ns + S:
            return False
        self._asked_ns = self.world.clock.now_ns
        is_late = self._asked_ns > self._calm_ns + CALM_S * S
        least_s = 2 * TIMEOUT_S if self.world.has_plc else RECORDED_S  # a trigger waits in vain for a press
        is_recorded = self._asked_ns > self._calm_ns + least_s * S
        is_calm = is_recorded and self.station.is_calm
        said = chain(audit_retained(self.world, self.station), audit_pieces(self.world, self.station))
        return is_late or (is_calm and not any(said))  # a PLC goes on, and what it began may be under way

    # The faults

    def _drawn_faults(self, seed: int) -> Iterator[Actor]:
        meetings = self.chosen.meetings
        drawn = [(name, rate, None) for name, rate in self.chosen.rates.items()]
        drawn += [(name, MET, number) for number, meeting in enumerate(meetings) for name in meeting]
        for name, rate, turn in drawn:
            rng = random.Random(f"{seed} {name} {turn}")
            first_ns = round(rng.expovariate(rate / 60) * S)
            yield Actor(f"fault {name}", partial(self._drawn, name, rate, turn, rng), S + first_ns)

    @property
    def _turn_of_meetings(self) -> int:
        """Which of them it is: each has its share of the presses, unless they take long."""
        by_presses = len(self.world.hand.presses) * len(self.chosen.meetings) // (self.run.presses + 1)
        return max(by_presses, self.world.clock.now_ns // (TURN_S * S))

    @property
    def meeting(self) -> tuple[str, ...]:
        """The faults whose turn it is."""
        meetings, turn = self.chosen.meetings, self._turn_of_meetings
        return meetings[turn] if turn < len(meetings) else ()

    @property
    def is_full_and_away(self) -> bool:
        """A full disk and a broker that is away meet now; and a kill waits for both."""
        return {"fill disk", "hang up"} <= set(self.meeting)

    def _drawn(self, name: str, rate: float, turn: int | None, rng: random.Random) -> float:
        if turn not in (None, self._turn_of_meetings):
            return 0.5
        if self._is_unanswered(name):
            return 0.1
        is_aimed = name in self._aimed or (
            turn is not None and "fill disk" in self.meeting and name in MOMENTS
        )
        if is_aimed and rng.random() < PATIENCE and not MOMENTS[name](self):
            return 0.1
        lasts_s = self._begin(name, rng.getrandbits(32))
        if lasts_s < 0:  # tried again so soon
            return -lasts_s
        self._aimed ^= {name} & set(MOMENTS)
        return lasts_s + rng.expovariate(rate / 60)

    def _given_faults(self, schedule: Sequence[Fault]) -> Iterator[Actor]:
        for number, fault in enumerate(schedule):
            yield Actor(f"fault {number}", partial(self._given, fault), round(fault.at_s * 1e6) * 1000)

    def _is_unanswered(self, name: str) -> bool:
        """Nobody answers what this needs."""
        return name in NEEDS_ANSWER and not self.station.is_between_turns

    def _given(self, fault: Fault) -> float:
        if self._is_unanswered(fault.name):
            return 0.1
        self._begin(fault.name, fault.seed)
        return 1e6

    def _begin(self, name: str, seed: int) -> float:
        """Begin a fault; returns how long it lasts. Less than 0: none has begun, and it is no part of the schedule."""
        fault = Fault(round(self.world.clock.now_ns / S, 6), name, seed)
        self.run.schedule.append(fault)
        lasts_s = FAULTS[name](self, random.Random(seed))
        if lasts_s < 0:
            self.run.schedule.remove(fault)
        else:
            self.run.counted[name] += 1
        return lasts_s

    def join(self, name: str, act: Callable[[], float]) -> Callable[[], None]:
        """Let somebody else take turns, until what is returned is called."""
        actor = Actor(name, act, self.world.clock.now_ns)
        self._actors.append(actor)

        def leave() -> None:
            self._actors = [one for one in self._actors if one is not actor]

        return leave

    def later(self, seconds: float, do: Callable[[], object]) -> None:
        """Let something happen once."""

        def once() -> float:
            do()
            self._actors = [one for one in self._actors if one is not actor]
            return 0.0

        actor = Actor("fault later", once, self.world.clock.now_ns + round(seconds * S))
        self._actors.append(actor)

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

        self.ending[name] = over

        def ended() -> float:
            if self.ending.pop(name, None):
                over()
            self._actors = [one for one in self._actors if one is not actor]
            return 0.0

        actor = Actor(f"end of {name}", ended, self.world.clock.now_ns + round(lasts_s * S))
        self._actors.append(actor)
        self.note(f"{name}, for {lasts_s:.1f} s")
        if name.split()[0] not in self.world.brokers:
            self.reach(name) if name.startswith(("relay", "pedal", "plc", "overview")) else self.reach_here(
                name
            )
        return lasts_s

    def _rise(self) -> None:
        """The process is dead: the next one opens what the disk holds."""
        disk = self.station.disk
        self.note(f"{'the power is lost' if disk.lost else 'killed'} at {disk.killed_at}")
        self.run.counted["crashes at a write"] += 1
        self.reach(f"killed at {'a file' if ' ' in disk.killed_at else disk.killed_at}")
        self.reach("killed during a press" if self.world.hand.press else "killed between presses")
        if self.is_broker_away:
            self.reach("killed while a broker was away")
        if disk.is_full:
            self.reach("killed while the disk was full")
            self.note_uncounted()
        if disk.lost:
            self.world.may_lack_files(self.world.clock.now_ns)
            self.world.has_lost_power = True
        self.world.sensor.disturb("the gateway was killed")
        self.station.bury()
        self.open_again()

    def note_uncounted(self) -> None:
        """The process ends, and presses that wait for room on the disk with it; they count on the gel at the next start
        (docs/operations.md)."""
        disk, now_ns = self.station.disk, self.world.clock.now_ns
        # A full disk may still have room for a press in what is there already.
        recorded_ns = max((seen.frame_ns or seen.came_ns for seen in self.station.seen), default=0)
        since_ns = max(disk.full_since_ns, recorded_ns)
        for press in self.world.hand.presses:
            is_waiting = press.begin_ns > since_ns and 0 < press.end_ns < now_ns - 2 * S
            is_lost = is_waiting and not (press.must_count or press.why - {"the station said 'halted'"})
            press.must_count |= is_lost
            self.station.is_loss_open |= is_lost
        self.world.sensor.disturb("it waited for room", (now_ns - disk.full_since_ns) / S + 2)
        # The count that waits for a broker is corrected at the next start, and then the broker comes back.
        if is_held_up(self) and self.rng.random() < 0.7:
            self.later(BROKERS_S, self._mend_brokers)
            self.reach("ended with a press and a result that waited, and then a broker came back")

    def _mend_brokers(self) -> None:
        for name in [name for name in self.ending if name.split()[0] in self.world.brokers]:
            self.ending.pop(name)()

    def open_again(self) -> None:
        """Begin the next life, with the station's own sensor; the service manager starts again what cannot start."""
        if "another sensor" in self.ending:
            self.ending.pop("another sensor")()
        # A station that names none takes the only one that is plugged in.
        if not (self.world.sensor.is_plugged or self.chosen.has_serial) and "second sensor" in self.ending:
            self.ending.pop("second sensor")()
        try:
            self.station.open()
        except (StoreError, BundleError, ConfigError) as error:
            self.note(f"the start failed: {error}")
            self.reach("a start failed, and the next one did not")
            is_bundles = not isinstance(error, StoreError)
            self.reach("a start was refused for its bundle") if is_bundles else None
            ends = (
                ("bundle of", "configuration")
                if is_bundles
                else ("disk errs", "disk full", "database locked")
            )
            found = [name for name in self.ending if name.startswith(ends)]
            if not found:
                raise
            for fault in found:
                self.ending.pop(fault)()
            self.open_again()
            return
        for actor in self._threads.own:
            actor.due_ns = self.world.clock.now_ns

    def _begin_config(self) -> Config:
        """Read what a person has written, who gives the brokers another order."""
        before = list(self.order)
        self.rng.shuffle(self.order)
        if self.order != before and self.station.lives > 1:
            self.reach("restarted with the sinks in another order")
        self.write_config()
        return self._read_config()

    def write_config(self) -> None:
        """Write what a person has edited."""
        archive = f"[archive]\npresses = {ARCHIVED if self.chosen.has_archive else 0}\n"
        paths = "".join(f'[[inspection.bundles]]\npath = "{path}"\n' for path in self._bundles)
        shadows = [str(self._bundles[0].with_name("shadow"))] if self.chosen.has_shadow else []
        text = CONFIG.format(
            bundles=paths,
            folder=self._disk,
            archive=archive,
            secret=self._secret,
            trigger=self.chosen.trigger,
            shadows=shadows,
            again='press_again = "unsure"' if AGAIN in self.chosen.features else "",
            more=", ".join(f'"{name}"' for name in self.chosen.features if name not in (OVERVIEW, AGAIN)),
            sensor=f'options = {{ serial = "{SERIAL}" }}' if self.chosen.has_serial else "",
        )
        text += TABLES.replace('"acknowledge"', '"trigger"') if self.chosen.has_pedal else TABLES
        text += "".join(SINK.format(name=name) for name in self.order)
        text += PIECE.format(order=self.chosen.piece) if self.world.has_pieces else ""
        text += OVERVIEW_TABLE if OVERVIEW in self.chosen.features else ""
        text += MASTER_TABLE if REFERENCE in self.chosen.features else ""
        text += f"[press_again]\nwithin_s = {WITHIN_S}\n" if AGAIN in self.chosen.features else ""
        text += HANDSHAKE if self.world.has_plc else ""
        text += FILE.format(folder=self._disk / MESSAGES) if self.chosen.has_file else ""
        text += PAGE.format(file=self._token) if self.chosen.has_page else ""
        self._config.write_text(self.world.edited.write(text))

    def _read_config(self) -> Config:
        config = load_config(self._config)
        store = config.store.model_copy(update={"outbox_mb": self.chosen.outbox_mb})
        return config.model_copy(update={"store": store})


@contextmanager
def _standing_in(rng: random.Random, seed: int, clock: SimulatedClock, disk: Disk) -> Iterator[None]:
    """Let the run give what the program takes from the machine: a generator without a seed gets one, and ids their
    bytes; a computation takes no time, and the disk says how much room it has."""
    real, urandom, perf_counter, disk_usage = random.Random, os.urandom, time.perf_counter, shutil.disk_usage
    ids = real(f"{seed} ids")

    class Drawn(real):  # type: ignore[misc, valid-type]
        def __init__(self, seed: object = None) -> None:
            super().__init__(rng.getrandbits(64) if seed is None else seed)

    random.Random, os.urandom = Drawn, ids.randbytes  # type: ignore[misc]
    time.perf_counter = lambda: clock.now_ns / S
    shutil.disk_usage = lambda path: SimpleNamespace(free=disk.free_bytes)  # type: ignore[assignment]
    try:
        yield
    finally:
        random.Random, os.urandom = real, urandom  # type: ignore[misc]
        time.perf_counter, shutil.disk_usage = perf_counter, disk_usage
