"""The threads of a station, each an actor that takes a turn when the schedule draws it, or when it would be woken."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from edge.core.errors import GelgateError
from edge.features.overview import Overview
from edge.features.snapshots import Snapshots
from simulation.asked import WITHIN_S
from simulation.chosen import OVERVIEW, SNAPSHOT
from simulation.connections import Turns
from simulation.hand import MadePress
from simulation.sensor import S

if TYPE_CHECKING:
    from simulation.schedule import Simulation


FORGOTTEN = 3
"""Of seven presses nobody asks for this one."""
SOON_S, HOLDS_S = 0.5, 0.6
"""A pedal is heard after less than that."""
LATE_S = 0.1
"""A press that is asked for later may be lifted before it rests."""


@dataclass
class Actor:
    """A turn of the station or of its surroundings. act: returns the seconds until it is due again."""

    name: str
    act: Callable[[], float]
    due_ns: int = 0


class Threads:
    """Those of the station, `own`, and what goes on outside of it: the camera, and the brokers."""

    def __init__(self, run: "Simulation") -> None:
        self._run = run
        self._look_ns: dict[str, int] = {}
        self.camera = Actor("camera", self._camera)
        connections = run.world.connections
        turns = connections.turns["loop"] = Turns(self._loop)
        self._reader, self._looper = Actor("reader", self._read), Actor("loop", turns.act)
        self._relay = Actor("relay", self._switch)
        drawer = connections.turns["pictures"] = Turns(self._draw)
        threads = [self._reader, self._looper, Actor("pictures", drawer.act)]
        threads += [
            Actor("bundles", self._open_bundles),
            Actor("pedal", self._tread),
            self._relay,
        ]
        threads.append(Actor("network", self._pump))
        for name in self._run.world.brokers:
            work = {name: self._publish, f"{name} connect": self._connect, f"{name} commands": self._answer}
            for thread, turn in work.items():
                turns = connections.turns[thread] = Turns(partial(turn, name))
                threads.append(Actor(thread, turns.act))
        if run.chosen.has_file:
            turns = connections.turns["file"] = Turns(partial(self._publish, "file"))
            threads.append(Actor("file", turns.act))
        if SNAPSHOT in run.chosen.features:
            threads.append(Actor("snapshots", self._write_snapshots))
        if OVERVIEW in run.chosen.features:
            threads.append(Actor("overview", self._look_over))
        if run.chosen.has_page:
            for name, turn in {"page": partial(self._publish, "page"), "browser": run.browser.act}.items():
                turns = connections.turns[name] = Turns(turn)
                threads.append(Actor(name, turns.act))
        connections.on_news = self._wake_waiting
        self.own = threads
        plcs = [Actor("plc", plc.act) for plc in run.world.plcs]
        self._slipped: MadePress | None = None
        if run.chosen.has_pedal:
            plcs.append(Actor("person with a pedal", self._ask_by_pedal))
        if run.world.has_pieces and not run.world.has_plc:
            plcs.append(Actor("person with a plan", lambda: run.world.worker.act(run)))
        self.all = [self.camera, *threads, Actor("brokers", self._work), *plcs]

    def _wake_waiting(self) -> None:
        """Something has come from a broker: those who wait for it look."""
        for actor in self.own:
            turns = self._run.world.connections.turns.get(actor.name)
            if turns is not None and turns.is_waiting and "process frozen" not in self._run.ending:
                actor.due_ns = min(actor.due_ns, self._run.world.clock.now_ns)

    def freeze(self, seconds: float) -> None:
        """Let no thread of the station take a turn for so long."""
        self._run.station.is_frozen = self._run.world.server.is_frozen = seconds > 0
        for actor in self.own:
            actor.due_ns = self._run.world.clock.now_ns + round(seconds * S)

    def _camera(self) -> float:
        sensor, hand = self._run.world.sensor, self._run.world.hand
        before, state = hand.press, self._run.station.loop.parts.status.view().state
        sensor.make(state == "ready")
        press = hand.press
        if state != "ready":
            self._run.station.halted_ns.append(self._run.world.clock.now_ns)
            if press:
                press.why.add(f"the station said '{state}'")
        if press is not before and press is not None:
            self._run.note(f"press {press.number} begins, {press.what}, {press.way}")
            press.is_asked = self._run.chosen.trigger == "automatic"
            if press.master_ns:
                self._doubt_master(press)
        if self._run.station.is_disk_disturbed or self._run.station.loop.is_halted:
            for made in hand.presses[-2:]:
                made.may_count = True
        if not self._run.station.is_between_turns and not self._run.station.is_frozen:
            self._run.station.loop.watch()  # each second, by a thread of its own
        self._wake(self._reader)
        return (sensor.next_ns - self._run.world.clock.now_ns) / S

    def _doubt_master(self, press: MadePress) -> None:
        """The station may not wait for it any more: what is mounted has changed, or it began again."""
        world, asked_ns = self._run.world, press.master_ns - S
        told_ns = [when_ns for when_ns, _ in self._run.station.told[-1:]]  # another bundle is mounted
        changes_ns = (world.parts.last_ns, world.gels.last_ns, self._run.station.began_ns, *told_ns)
        if max(changes_ns) > asked_ns or press.begin_ns - asked_ns > WITHIN_S * S:
            press.why.add("the master piece was asked for before a change")

    def _read(self) -> float:
        acquisition = self._run.station.loop.parts.acquisition
        frames = acquisition.status.frames
        pause_s = acquisition.step()
        if acquisition.status.frames != frames:
            self._wake(self._looper)
        return pause_s or (self._lag(0.002) if self._run.world.sensor.has_frame else 0.25)

    def _wake(self, actor: Actor) -> None:
        """A thread that waits for this has something to do, unless it pauses or does not run."""
        if "process frozen" not in self._run.ending and actor.due_ns - self._run.world.clock.now_ns <= S // 4:
            actor.due_ns = min(actor.due_ns, self._run.world.clock.now_ns + round(self._lag(0.001) * S))

    def _obey(self) -> None:
        """The person at the station asks for the verdict of a press, unless it has a pedal for it, and forgets each
        seventh; reads the alarm, and leaves the gel free for a while."""
        hand, now_ns, noticed_s = (
            self._run.world.hand,
            self._run.world.clock.now_ns,
            self._run.world.noticed_s,
        )
        is_asking = not self._run.chosen.has_pedal
        if is_asking and (press := hand.press) and not press.is_asked and press.number % 7 != FORGOTTEN:
            waited_s = (now_ns - press.begin_ns) / S - noticed_s
            with suppress(GelgateError, ValueError):  # it sees no contact yet
                if waited_s > 0:
                    self._run.station.ask("trigger")
                    press.is_asked = True
                    press.why |= {"it was asked for late"} if waited_s > LATE_S else set()
        said = self._run.station.loop.parts.status.view().alarms
        if "contact" in said and hand.is_pressing_soon:
            self._run.reach("the hand lifted because the station asked for it")
            hand.wait(3)

    def _ask_by_pedal(self) -> float:
        """The person treads on the pedal when the part lies there, and holds it on. Of each seventh press it treads too
        soon, while the gel is free: that asks for nothing (docs/contact.md, Triggers)."""
        hand, pedal, press = self._run.world.hand, self._run.world.pedal, self._run.world.hand.press
        if press is None:
            is_forgotten = len(hand.presses) % 7 == FORGOTTEN and hand.presses[-1] is not self._slipped
            if is_forgotten and hand.free_s > SOON_S:
                self._slipped = hand.presses[-1]
                self._run.reach("a person trod on the pedal, and nothing pressed")
                pedal.step_on()
            return 0.05
        if not pedal.is_sure:
            press.why.add("the pedal was disturbed")
        is_missed = press.is_asked or press.number % 7 == FORGOTTEN
        if not is_missed and hand.is_down:
            press.is_asked = True
            self._run.reach("a person asked for a verdict with the pedal")
            pedal.step_on()
            if press.way == "brief":
                press.why.add("it was asked for late")
            else:
                hand.hold(HOLDS_S)
        return 0.05

    def _loop(self) -> float:
        loop = self._run.station.loop
        self._run.station.hang("a turn")
        self._obey()
        frame = loop.parts.acquisition.next(0)
        if frame is not None:
            self._run.station.fed_ns.append(frame.timestamp_ns)
        was_halted = loop.is_halted
        loop.step(frame)
        self._run.station.hear_answers()
        if loop.is_halted != was_halted:
            self._run.reach(
                "the store refused a press" if loop.is_halted else "the store took what had waited"
            )
            self._run.note("the store refuses" if loop.is_halted else "the store accepts again")
        (driver,) = self._run.station.outputs.drivers
        if driver._has_news:
            driver._has_news = False
            self._wake(self._relay)
        return self._lag(0.001) if frame is not None else 0.2

    def _draw(self) -> float:
        self._run.station.loop.parts.pictures.step()
        return 0.2 + self._lag(0.2)

    def _open_bundles(self) -> float:
        self._run.station.loop.parts.selection.worker.step()
        return 0.2 + self._lag(0.2)

    def _write_snapshots(self) -> float:
        stage = self._run.station.loop.find(Snapshots)
        assert stage is not None
        stage.worker.step()
        return 0.2 + self._lag(0.2)

    def _look_over(self) -> float:
        stage, camera = self._run.station.loop.find(Overview), self._run.world.overview
        assert stage is not None
        assert camera is not None
        pause_s = stage.camera.step()
        return pause_s or max(0.02, (camera.next_ns - self._run.world.clock.now_ns) / S) + self._lag(0)

    def _switch(self) -> float:
        (driver,) = self._run.station.outputs.drivers
        pause_s = driver.step()
        self._run.station.switch_turns_ns.append(self._run.world.clock.now_ns)
        return pause_s + self._lag(0)

    def _tread(self) -> float:
        (reader,) = self._run.station.outputs.readers
        return (reader.step() or 0.1) + self._lag(0)

    def _publish(self, name: str) -> float:
        workers = self._run.station.loop.parts.publisher.workers
        others = ["file"] * self._run.chosen.has_file + ["page"] * self._run.chosen.has_page
        worker = list(workers.values())[[*self._run.order, *others].index(name)]
        pause_s = worker.step()
        return pause_s if not worker.counters.is_up else min(pause_s, 0.2 + self._lag(0.2))

    def _connect(self, name: str) -> float:
        sink, now_ns = self._run.world.connections.sinks[name], self._run.world.clock.now_ns
        pause_s = sink.step()
        if pause_s is not None or name not in self._look_ns:
            self._look_ns[name] = now_ns + round(sink.look_again_s * S)
        elif now_ns > self._look_ns.get(name, 0):
            sink.look_again()
            self._look_ns[name] = now_ns + round(sink.look_again_s * S)
        return 0.25 if pause_s is None else pause_s

    def _answer(self, name: str) -> float:
        sink = self._run.world.connections.sinks[name]
        if sink._requests._waiting.empty() or self._run.station.shared.is_store_held:
            return 0.1 + self._lag(0.1)
        request = sink._requests.next()
        if request is not None:
            sink.answer(request)
        return 0.0

    def _pump(self) -> float:
        connections = self._run.world.connections
        connections.pump()
        return min(0.25, max(0.0, (connections.next_ns() - self._run.world.clock.now_ns) / S))

    def _work(self) -> float:
        for broker in self._run.world.brokers.values():
            broker.work()
        return 0.5

    def _lag(self, least_s: float) -> float:
        return least_s + self._run.rng.random() * self._run.chosen.sloth_s
