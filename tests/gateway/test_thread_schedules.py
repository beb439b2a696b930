"""What two threads share, under every order in which they may take turns.

Real threads run the production objects, and frontrun says which of them goes on at each access to what they share,
until no other order can differ. `make threads` has longer threads. Each object is also explored without its lock: an
exploration that does not find that, finds nothing.
"""

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from types import SimpleNamespace
from typing import Any, ClassVar

import frontrun
import pytest

from edge.acquisition import Acquisition, AcquisitionState, AcquisitionStatus
from edge.background import Background
from edge.clock import ManualClock
from edge.core.digital_io import StationView
from edge.core.errors import GelgateError
from edge.core.handshake import HandshakeMachine, Trigger
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import DeviceIdentity, Message
from edge.features.handshake.port import Port
from edge.features.outputs.stage import Outputs
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.status import StationStatus
from edge.messaging.publisher import Publisher
from edge.messaging.sink_worker import RetainedState

TURNS = int(os.environ.get("GELGATE_TURNS", "1"))


@pytest.fixture(autouse=True)
def _explored(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Without the variable frontrun leaves the locks of the objects as they are; what is logged is not explored."""
    monkeypatch.setenv("FRONTRUN_ACTIVE", "1")
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


def breaks(
    kind: Callable[..., Any], threads: Sequence[Callable[[Any], object]], *given: object, **options: Any
) -> str | None:
    """Return what breaks the `holds` of such an object, None where no order of these threads does."""
    options = {"clock": "virtual", "preemption_bound": None, "reproduce_on_failure": 0} | options
    options |= {"detect_io": False, "total_timeout": 600.0}
    found = frontrun.explore(partial(kind, *given), list(threads), lambda one: one.holds(), **options)
    return None if found.property_holds else str(found.explanation)


class NoLock:
    """A condition that keeps nobody out."""

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...

    def wait_for(self, is_so: Callable[[], object], timeout_s: float) -> None: ...

    def notify_all(self) -> None: ...


class Camera:
    """A sensor with a new frame at every reading."""

    identity = DeviceIdentity("GelSight Mini", "A", (64, 48), 20.0)

    def __init__(self) -> None:
        self.frames = 0

    def read(self, deadline_ns: int) -> CameraFrame:
        self.frames += 1
        return CameraFrame(b"%d" % self.frames, self.frames, self.frames)

    def close(self) -> None: ...


class Mailbox:
    """The frames between the reader and the loop, with room for one: each is taken or dropped, and counted."""

    def __init__(self, lock: Any = None) -> None:
        self.acquisition = Acquisition(Camera, ManualClock(), depth=1)
        if lock is not None:
            self.acquisition._changed = lock
        self.acquisition.step()
        self.taken: list[int] = []

    def read(self) -> None:
        for _ in range(TURNS + 1):
            self.acquisition.step()

    def take(self) -> None:
        for _ in range(TURNS):
            if (frame := self.acquisition.next(0)) is not None:
                self.taken.append(frame.sequence)

    def holds(self) -> bool:
        self.take()
        self.take()
        status = self.acquisition.status
        return (
            self.taken == sorted(set(self.taken))
            and self.taken[-1] == TURNS + 1
            and len(self.taken) + status.dropped == status.frames == TURNS + 1
        )


class Lane:
    """The present state between the station's threads and a publisher: no change is passed over."""

    def __init__(self, lock: Any = None) -> None:
        self.state = RetainedState()
        if lock is not None:
            self.state._lock = lock
        self.version = max(version for version, _ in self.state.since(-1))
        self.sent: dict[str, bytes] = {}

    def announce(self, topic: str) -> None:
        for turn in range(TURNS):
            self.state.announce(Message(topic, b"%d" % turn, retain=True))

    def send(self) -> None:
        for version, message in self.state.since(self.version):
            self.sent[message.topic], self.version = message.payload, version

    def holds(self) -> bool:
        self.send()
        return self.sent == dict.fromkeys(("state", "info"), b"%d" % (TURNS - 1))


class WakesLate:
    """An event that is cleared before the wait, and so forgets what was set since the last look."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def set(self) -> None:
        self._event.set()

    def clear(self) -> None: ...

    def wait(self, seconds: float) -> None:
        self._event.clear()
        self._event.wait(seconds)


class Waking:
    """A publisher's thread, and one that has something for it: it is sent before an idle publisher's pause ends."""

    name = "memory"
    counters = SimpleNamespace(is_up=True)

    def __init__(self, wake: type = threading.Event) -> None:
        self.publisher = Publisher.__new__(Publisher)  # without a database: this is about its threads
        self.publisher._stopping = threading.Event()
        self.publisher._wakes = {self.name: wake()}
        self.waiting: list[str] = []
        self.sent_s: list[float] = []
        self.began_s = time.monotonic()

    def step(self) -> float:
        """The step of a worker."""
        while self.waiting:
            self.waiting.pop()
            self.sent_s.append(time.monotonic() - self.began_s)
        return 5.0

    def publish(self) -> None:
        self.publisher._run(self)  # type: ignore[arg-type]

    def put(self) -> None:
        self.waiting.append("press")
        self.publisher.wake()
        while not self.sent_s:
            time.sleep(0.1)
        self.publisher._stopping.set()
        self.publisher.wake()

    def holds(self) -> bool:
        return len(self.sent_s) == 1 and self.sent_s[0] < 5.0


@dataclass
class Asked:
    """A request to the loop, which ends: it is done and answered, or refused at once and not done."""

    lock: Any = None
    done: list[str] = field(default_factory=list)
    answers: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.calls: LoopCalls[None] = LoopCalls(ManualClock(), answer_s=5.0)
        if self.lock is not None:
            self.calls._lock = self.lock

    def ask(self) -> None:
        try:
            self.answers.append(self.calls.ask(lambda state: self.done.append("done") or "done"))
        except GelgateError as error:
            self.answers.append(str(error))

    def end(self) -> None:
        self.calls.serve(None)
        self.calls.close(None)

    def serve(self) -> None:
        self.calls.serve(None)

    def holds(self) -> bool:
        self.calls.serve(None)
        if self.answers == ["done"]:
            return self.done == ["done"]
        return self.done == [] and self.answers[0].startswith(
            ("the station is ending", "the station did not")
        )


class AskedInVain(Asked):
    """As `Asked`; who asks a loop that ends does not wait for its answer."""

    def holds(self) -> bool:
        return super().holds() and not self.answers[0].startswith("the station did not")


class Job:
    """A job in the background: what was asked for last is done, and its outcome taken once."""

    def __init__(self, lock: Any = None) -> None:
        self.worker: Background[str] = Background("job", 0.0)
        if lock is not None:
            self.worker._exchange = lock
        self.outcomes: list[str] = []

    def ask(self) -> None:
        self.worker.ask(lambda: "done")

    def work(self) -> None:
        for _ in range(TURNS):
            self.worker.step()

    def take(self) -> None:
        for _ in range(TURNS):
            if (outcome := self.worker.take()) is not None:
                self.outcomes.append(outcome)

    def holds(self) -> bool:
        self.worker.step()
        self.take()
        return self.outcomes == ["done"] and not self.worker.is_busy


class Fault:
    """The reader loses its sensor while the loop sees the gel again: the station is halted, with the alarm. The order
    that breaks it without its lock is the 300th and more that is tried: there every unguarded access counts."""

    unlocked: ClassVar = {"error_on_any_race": True}

    def __init__(self, lock: Any = None) -> None:
        self.status = StationStatus(lambda message: None, ManualClock())
        if lock is not None:
            self.status._lock = lock
        self.status.set_blind("it is black")

    def lose(self) -> None:
        self.status.sensor_changed(AcquisitionStatus(AcquisitionState.FAULT, fault="it is gone"))

    def see(self) -> None:
        self.status.set_blind(None)

    def holds(self) -> bool:
        view = self.status.view()
        return view.state == "halted" and view.alarms == {"device"}


class Boards:
    """Two relay boards of one hub: the alarm names each that is away, and counts each pulse that was not given."""

    def __init__(self, lock: Any = None) -> None:
        self.alarms: dict[str, str | None] = {}
        self.outputs = Outputs(self.alarms.__setitem__, ManualClock())
        if lock is not None:
            self.outputs._lock = lock

    def lose(self, name: str) -> None:
        self.outputs.note_fault("actuator", name, "it is gone")
        self.outputs.note_late(name, "late")

    def holds(self) -> bool:
        return self.alarms["actuator"] == "1: it is gone; 2: it is gone" and "2 pulses" in str(
            self.alarms["pulse"]
        )


class Answered:
    """A PLC ends a handshake and begins the next one while the loop records the press of the first: no pass of another
    id is seen, nor one that is not recorded."""

    def __init__(self, lock: Any = None) -> None:
        self.clock = ManualClock()
        machine = HandshakeMachine(10**10, None, self.clock.monotonic_ns(), is_command=False)
        store = SimpleNamespace(begin_act=lambda *given: None)  # takes what is refused in some orders
        self.port = Port(machine, None, store, self.clock, lambda *given: None)  # type: ignore[arg-type]
        if lock is not None:
            self.port._lock = lock
        now_ns = self.clock.monotonic_ns()
        machine.show(StationView("ready"), 42, now_ns)
        machine.look(False)
        machine.trigger(Trigger(1), now_ns)
        machine.reach(1)
        machine.begin(now_ns)
        machine.judge("P1", "pass", now_ns, part="A/1")
        self.is_recorded = False
        self.passed: list[tuple[int, bool]] = []

    def ask(self) -> None:
        for trigger_id in range(2, 2 + TURNS):
            self.read()
            self.port.acknowledge()
            self.port.trigger(Trigger(trigger_id))
            self.read()

    def read(self) -> None:
        if (view := self.port.read()).is_pass:
            self.passed.append((view.trigger_id, self.is_recorded))

    def record(self) -> None:
        self.is_recorded = True
        with self.port.machine() as (machine, now_ns):
            machine.record("P1", now_ns)

    def holds(self) -> bool:
        self.read()
        return set(self.passed) <= {(1, True)}


SHARED: Sequence[tuple[type, Any, Sequence[Callable[[Any], object]]]] = [
    (Mailbox, NoLock, [Mailbox.read, Mailbox.take]),
    (Lane, nullcontext, [lambda lane: lane.announce("state"), lambda lane: lane.announce("info"), Lane.send]),
    (AskedInVain, nullcontext, [Asked.ask, Asked.end]),
    (Job, nullcontext, [Job.ask, Job.work, Job.take]),
    (Fault, nullcontext, [Fault.lose, Fault.see]),
    (Answered, nullcontext, [Answered.ask, Answered.record]),
    (Boards, nullcontext, [lambda boards: boards.lose("1"), lambda boards: boards.lose("2")]),
]
NAMES = [kind.__name__ for kind, _, _ in SHARED]


@pytest.mark.parametrize(("kind", "no_lock", "threads"), SHARED, ids=NAMES)
def test_no_order_of_its_threads_breaks_it(kind: type, no_lock: Any, threads: Any) -> None:
    """See the sentence of each."""
    assert breaks(kind, threads) is None


@pytest.mark.parametrize(("kind", "no_lock", "threads"), SHARED, ids=NAMES)
def test_without_its_lock_some_order_breaks_it(kind: type, no_lock: Any, threads: Any) -> None:
    """The lock is needed, and the exploration would find that it is missing. `unlocked` is not for the test with the
    lock: frontrun 0.7 tells of a release after it is done, so that what the next thread does until then counts as a
    race, at random."""
    assert breaks(kind, threads, no_lock(), **getattr(kind, "unlocked", {})) is not None


def test_a_call_that_was_refused_is_not_done_later() -> None:
    """The time of waiting may end between any two steps of the loop."""
    assert breaks(Asked, [Asked.ask, Asked.serve], clock="explored") is None


def test_a_publisher_is_never_asleep_with_something_to_send() -> None:
    """A wake between its look at the outbox and its pause is not lost; with an event that forgets it would be."""
    assert breaks(Waking, [Waking.publish, Waking.put]) is None
    assert breaks(Waking, [Waking.publish, Waking.put], WakesLate) is not None
