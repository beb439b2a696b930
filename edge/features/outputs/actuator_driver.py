"""The owner of one relay board, light or buzzer: keeps its outputs at what the station shows, and gives pulses in time.

A pulse that cannot start before its deadline is not given: it would hit the next part. It is reported instead. Without
a sign of life from the loop the outputs go to those of the state `halted`.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from edge.core.backoff import Backoff
from edge.core.digital_io import Actuator, OutputRule, StationView
from edge.core.errors import DeviceError
from edge.core.ports import Clock
from edge.core.sentence import Sentence, join_sentences
from edge.features.outputs.connection import Connection, OnFault

__all__ = ["ActuatorDriver", "levels", "next_blink_ns"]

log = logging.getLogger(__name__)

_LONGEST_WAIT_NS: Final = 250_000_000
# A device that does not return is left after this time.
CLOSE_S: Final = 5.0


@dataclass(frozen=True)
class _Pulse:
    """Asked for: on `channel`, started by `start_by_ns`, for `length_ns`."""

    channel: int
    start_by_ns: int
    length_ns: int
    verdict: str


class ActuatorDriver:
    """Owns the device from `start` to `close`.

    on_late: called with one sentence for every pulse that was not given in time. watchdog_ns: without `show` for this
    time the loop hangs. `step` is one turn of the owner without its thread; a test may call it instead of `start`.
    `show` and `pulse` are for other threads, and return at once. A call of the device that takes longer than the
    watchdog is a fault too, which `show` reports.
    """

    def __init__(
        self,
        open_actuator: Callable[[], Actuator],
        rules: Sequence[OutputRule],
        clock: Clock,
        on_fault: OnFault,
        on_late: Callable[[str], None],
        *,
        watchdog_ns: int,
        backoff: Backoff | None = None,
    ) -> None:
        self._connection = Connection(open_actuator, clock, backoff)
        self._rules, self._clock = tuple(rules), clock
        self._on_fault, self._on_late, self._watchdog_ns = on_fault, on_late, watchdog_ns
        self._changed = threading.Condition()
        self._view, self._shown_ns = StationView(), clock.monotonic_ns()
        self._asked: deque[_Pulse] = deque()
        self._written: dict[int, bool] = {}
        self._on_until_ns: dict[int, int] = {}
        self._is_hanging = False
        self._began_ns: int | None = None  # the turn that the owner takes now
        self._is_closing = False
        self._has_news = False
        self._thread = threading.Thread(target=self._run, name="actuator", daemon=True)

    def start(self) -> None:
        """Begin to connect and switch, in the background. The watchdog counts from now."""
        self._shown_ns = self._clock.monotonic_ns()
        self._thread.start()

    def show(self, view: StationView) -> None:
        """Take what the station is now, which is also the sign that its loop is alive."""
        with self._changed:
            is_new, self._view = view != self._view, view
            self._shown_ns = self._clock.monotonic_ns()
            if is_new:
                self._wake()
        if self._began_ns is not None:  # the owner cannot while a call of the device does not return
            self._expire()
            self._say()

    def pulse(self, verdict: str, judged_ns: int) -> None:
        """Give the pulses of this verdict. judged_ns: when the judged frame came, from which deadlines count."""
        with self._changed:
            for rule in self._rules:
                if rule.pulse_ns is not None and rule.deadline_ns is not None and verdict in rule.when:
                    start_by_ns = judged_ns + rule.deadline_ns
                    self._asked.append(_Pulse(rule.channel, start_by_ns, rule.pulse_ns, verdict))
                    self._wake()

    def _wake(self) -> None:
        self._has_news = True
        self._changed.notify_all()

    # The owner thread

    def step(self) -> float:
        """Take one turn: open where it is away, give pulses, switch levels; returns the seconds until the next one."""
        self._began_ns = self._clock.monotonic_ns()
        try:
            self._watch()
            actuator = self._connection.open()
            if actuator is not None:
                self._turn(actuator)
                self._connection.works()
        except Exception as error:  # noqa: BLE001 - the owner's edge: any fault becomes an alarm
            self._written, self._on_until_ns = {}, {}
            self._connection.lost(error)
        self._began_ns = None
        self._say()
        self._expire()
        return max(0.0, (self._next_ns() - self._clock.monotonic_ns()) / 1e9)

    def _turn(self, actuator: Actuator) -> None:
        self._check_channels(actuator)
        while (pulse := self._next_pulse()) is not None:
            self._give(actuator, pulse)
        now_ns = self._clock.monotonic_ns()
        for channel, is_on in levels(self._rules, self._present_view(), now_ns).items():
            self._write(actuator, channel, is_on or self._on_until_ns.get(channel, 0) > now_ns)

    def _next_pulse(self) -> _Pulse | None:
        with self._changed:
            return self._asked.popleft() if self._asked else None

    def _give(self, actuator: Actuator, pulse: _Pulse) -> None:
        refusal = self._refusal(pulse)
        if refusal is not None:
            self._late(pulse, refusal)
            return
        try:
            self._write(actuator, pulse.channel, True)
        except Exception as error:
            self._late(pulse, Sentence(f"not given: {error}"))
            raise
        now_ns = self._clock.monotonic_ns()
        if now_ns > pulse.start_by_ns:  # the levels that follow switch it off
            self._late(pulse, Sentence(f"{_after(pulse, now_ns)}, and is switched off at once"))
        else:
            end_ns = max(self._on_until_ns.get(pulse.channel, 0), now_ns + pulse.length_ns)
            self._on_until_ns[pulse.channel] = end_ns

    def _refusal(self, pulse: _Pulse) -> str | None:
        """Return why this pulse is not given, or None."""
        now_ns = self._clock.monotonic_ns()
        if now_ns > pulse.start_by_ns:
            return Sentence(f"not given: it is {_after(pulse, now_ns)}")
        if self._is_hanging:
            return Sentence("not given: the station's loop does not answer")
        if self._present_view().state == "stopped":
            return Sentence("not given: the station ends")
        return None

    def _write(self, actuator: Actuator, channel: int, is_on: bool) -> None:
        if self._written.get(channel) != is_on:
            actuator.write(channel, is_on)
            self._written[channel] = is_on

    def _present_view(self) -> StationView:
        with self._changed:
            view, silent_ns = self._view, self._clock.monotonic_ns() - self._shown_ns
        return replace(view, state="halted") if self._is_hanging else view.after(silent_ns)

    def _watch(self) -> None:
        """The watchdog: a loop that hangs cannot see a fault itself."""
        with self._changed:
            silent_ns = self._clock.monotonic_ns() - self._shown_ns
            is_hanging = silent_ns > self._watchdog_ns and self._view.state != "stopped"
        self._is_hanging = is_hanging
        self._say()
        if is_hanging:
            self._on_until_ns = {}

    def _expire(self) -> None:
        """Pulses whose time passed while the device was away."""
        with self._changed:
            now_ns = self._clock.monotonic_ns()
            late = [pulse for pulse in self._asked if now_ns > pulse.start_by_ns]
            self._asked = deque(pulse for pulse in self._asked if now_ns <= pulse.start_by_ns)
        for pulse in late:
            self._late(pulse, Sentence(f"not given: it is {_after(pulse, now_ns)}"))

    def _late(self, pulse: _Pulse, why: str) -> None:
        self._on_late(Sentence(f"the pulse on channel {pulse.channel} for '{pulse.verdict}' was {why}"))

    def _check_channels(self, actuator: Actuator) -> None:
        highest = max(rule.channel for rule in self._rules)
        if highest > actuator.channels:
            raise DeviceError(
                f"{actuator.name} has {actuator.channels} channels, the configuration names channel {highest}; "
                "correct [[actuators.outputs]] or plug in the larger board"
            )

    def _next_ns(self) -> int:
        now_ns = self._clock.monotonic_ns()
        times = [now_ns + _LONGEST_WAIT_NS, *self._on_until_ns.values()]
        with self._changed:
            times += [pulse.start_by_ns + 1 for pulse in self._asked]
        if self._connection.port is None:
            return min(*times, max(self._connection.retry_ns, now_ns))
        blink_ns = next_blink_ns(self._rules, now_ns)
        return min(time for time in (*times, blink_ns) if time is not None and time > now_ns)

    def _say(self) -> None:
        began_ns = self._began_ns
        is_stuck = began_ns is not None and self._clock.monotonic_ns() - began_ns > self._watchdog_ns
        hanging = Sentence("the station's loop does not answer; its outputs are in the state `halted`")
        stuck = Sentence("a call of its driver does not end; its outputs stay as they are")
        words = [self._connection.fault, hanging if self._is_hanging else None, stuck if is_stuck else None]
        self._on_fault(join_sentences(word for word in words if word))

    def _run(self) -> None:
        while not self._is_closing:
            pause_s = self.step()
            with self._changed:
                if not self._has_news:
                    self._changed.wait(pause_s)
                self._has_news = False
        self._end()

    def _end(self) -> None:
        """The outputs of the state `stopped`, as far as the device can be reached; then it is released."""
        with self._changed:
            self._view, self._is_hanging = StationView("stopped"), False
        self._on_until_ns = {}
        self.step()
        self._connection.close()

    def close(self) -> None:
        """Switch to the outputs of the state `stopped` and release the device; may be called again."""
        with self._changed:
            self._is_closing = True
            self._wake()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)
            if self._thread.is_alive():
                log.error(
                    "a call of an output's driver does not end; the output is left as it is, check its wiring"
                )
        elif self._connection.port is not None:
            self._end()


def _after(pulse: _Pulse, now_ns: int) -> str:
    late_ms = (now_ns - pulse.start_by_ns) / 1e6
    return Sentence(f"{late_ms:.0f} ms after its deadline")


def levels(rules: Sequence[OutputRule], view: StationView, now_ns: int) -> Mapping[int, bool]:
    """Channel to level, without pulses. A channel of several rules is on where one of them switches it on."""
    conditions = view.conditions()
    channel_levels = {rule.channel: False for rule in rules}
    for rule in rules:
        if rule.pulse_ns is None:
            is_lit = rule.blink_ns is None or now_ns // rule.blink_ns % 2 == 0
            is_on = is_lit if rule.when & conditions else rule.safe and view.state != "ready"
            channel_levels[rule.channel] |= is_on
    return channel_levels


def next_blink_ns(rules: Iterable[OutputRule], now_ns: int) -> int | None:
    """When the next output that blinks changes; None where none does."""
    periods = {rule.blink_ns for rule in rules if rule.blink_ns is not None}
    return min(((now_ns // period + 1) * period for period in periods), default=None)
