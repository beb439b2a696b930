"""A station's side of the handshake, without a station: the machine, its time and its presses, told by a test."""

import threading

from edge.core.digital_io import State, StationView
from edge.core.handshake import Code, HandshakeMachine, HandshakeView, Refusal, Trigger

S = 10**9
TIMEOUT_S, WATCHDOG_S = 10, 1


class Bench:
    """A machine with a clock, and a station that is ready and sees a free gel."""

    def __init__(self, *, watchdog_s: float | None = None, is_command: bool = False) -> None:
        self.now_ns, self.state = S, "ready"
        watchdog_ns = None if watchdog_s is None else round(watchdog_s * S)
        self.machine = HandshakeMachine(TIMEOUT_S * S, watchdog_ns, self.now_ns, is_command=is_command)
        self.look(False)
        self.show()

    def show(self, state: State | None = None, *alarms: str) -> None:
        self.state = state or self.state
        self.machine.show(StationView(self.state, alarms=frozenset(alarms)), 42, self.now_ns)

    def look(self, is_touched: bool) -> None:
        self.machine.look(is_touched)

    def wait(self, seconds: float) -> None:
        """Time passes while the loop turns."""
        for _ in range(20):
            self.now_ns += round(seconds * S / 20)
            self.show()

    def trigger(self, trigger_id: int, part: str | None = None, *, is_behind: bool = False) -> Code:
        """is_behind: the loop has frames of before it to look at, and does not reach it."""
        refusal = self.machine.trigger(Trigger(trigger_id), self.now_ns, part)
        if refusal is None and not is_behind:
            self.machine.reach(trigger_id)
        return Code.NONE if refusal is None else refusal.code

    def begin(self) -> None:
        self.now_ns += S // 20
        self.look(True)
        self.machine.begin(self.now_ns)

    def judge(self, word: str, press_id: str = "P1", part: str = "A/1") -> None:
        self.now_ns += S // 20
        self.machine.judge(press_id, word, self.now_ns, part=part, score_ratio=0.5)

    def record(self, press_id: str = "P1") -> None:
        self.machine.record(press_id, self.now_ns)

    def lift(self) -> None:
        self.now_ns += S // 20
        self.look(False)

    def press(self, word: str, press_id: str = "P1", part: str = "A/1") -> None:
        """A whole press of a part."""
        self.begin()
        self.judge(word, press_id, part)
        self.record(press_id)
        self.lift()
        self.show()

    @property
    def seen(self) -> HandshakeView:
        return self.machine.read(self.now_ns)

    @property
    def result(self) -> tuple[str, int, str | None, Code]:
        view = self.seen
        return view.step, view.trigger_id, view.word, view.code


class BenchHandshake:
    """A `Handshake` on a bench, for a server. refused: what the server refused itself. taken: by the machine."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self._lock = bench, threading.Lock()
        self.refused: list[tuple[str, str]] = []
        self.taken: list[Trigger] = []

    def read(self) -> HandshakeView:
        with self._lock:
            return self.bench.seen

    def trigger(self, trigger: Trigger) -> Refusal | None:
        with self._lock:
            refusal = self.bench.machine.trigger(trigger, self.bench.now_ns)
            if refusal is None:
                self.bench.machine.reach(trigger.trigger_id)
                self.taken.append(trigger)
            return refusal

    def acknowledge(self) -> None:
        with self._lock:
            self.bench.machine.acknowledge(self.bench.now_ns)

    def beat(self) -> None:
        with self._lock:
            self.bench.machine.beat(self.bench.now_ns)

    def refuse(self, what: str, sentence: str) -> None:
        if what == "trigger":
            self.bench.machine.refuse(Refusal(Code.BAD_VALUE, sentence))
        self.refused.append((what, sentence))
