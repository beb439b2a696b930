"""A relay board and a pedal whose time and faults a test decides; what `write` does takes time of the test's clock."""

from collections import deque
from collections.abc import Callable
from typing import Any

from edge.clock import ManualClock
from edge.core.backoff import Backoff
from edge.core.errors import DeviceLost, DeviceNotFound


class FixedBackoff(Backoff):
    """Pauses of one second."""

    def __init__(self) -> None:
        super().__init__(rng=None, first_s=1.0, ceiling_s=1.0)  # type: ignore[arg-type]

    def failed(self) -> float:
        return 1.0


class Changes(list[str | None]):
    """The changes of a fault that is said with each turn, as a station's alarms compare."""

    def say(self, fault: str | None) -> None:
        if fault != [None, *self][-1]:
            self.append(fault)


class FakeRelay:
    """plugged_in: with the cable pulled, writing fails. silent: gone, and nothing fails. write_s: how long it takes.
    called: at each writing."""

    name, channels = "relay", 4

    def __init__(self, clock: ManualClock) -> None:
        self.clock = clock
        self.plugged_in, self.silent, self.write_s = True, False, 0.0
        self.state: dict[int, bool] = {}
        self.error: Exception | None = None
        self.called: Callable[[], object] = lambda: None
        self.history: list[tuple[int, int, bool]] = []
        self.openings = self.closings = 0

    def open(self) -> "FakeRelay":
        if not self.is_present():
            raise DeviceNotFound("no relay is plugged in")
        self.openings += 1
        return self

    def write(self, channel: int, is_on: bool) -> None:
        self.called()
        self.clock.sleep(self.write_s)
        if self.error is not None:
            raise self.error
        if not self.plugged_in:
            raise DeviceLost("the relay is gone")
        self.state[channel] = is_on
        self.history.append((self.clock.monotonic_ns() // 1_000_000, channel, is_on))

    def is_present(self) -> bool:
        return self.plugged_in and not self.silent

    def close(self) -> None:
        self.closings += 1

    @property
    def on(self) -> set[int]:
        return {channel for channel, is_on in self.state.items() if is_on}


class FakePedal:
    """Plays changes: (milliseconds after the first read, down or up)."""

    name = "pedal"

    def __init__(self, clock: ManualClock, *changes: tuple[float, bool]) -> None:
        self.clock, self.plugged_in, self.silent = clock, True, False
        self.error: Exception | None = None
        self.changes = deque((clock.monotonic_ns() + round(ms * 1e6), is_down) for ms, is_down in changes)
        self.openings = self.closings = 0

    def open(self) -> "FakePedal":
        if not self.is_present():
            raise DeviceNotFound("no pedal is plugged in")
        self.openings += 1
        return self

    def read(self, deadline_ns: int) -> bool | None:
        if self.error is not None:
            raise self.error
        if not self.plugged_in:
            raise DeviceLost("the pedal is gone")
        until = min([deadline_ns, *(at for at, _ in list(self.changes)[:1])])
        self.clock.sleep(max(0, until - self.clock.monotonic_ns()) / 1e9)
        if self.changes and self.changes[0][0] <= self.clock.monotonic_ns():
            return self.changes.popleft()[1]
        return None

    def is_present(self) -> bool:
        return self.plugged_in and not self.silent

    def close(self) -> None:
        self.closings += 1


def run(part: Any, clock: ManualClock, seconds: float) -> None:
    """Step the part for that time of the clock, as its thread would."""
    end_ns = clock.monotonic_ns() + round(seconds * 1e9)
    for _ in range(1_000):
        if clock.monotonic_ns() >= end_ns:
            return
        pause_s = part.step()
        clock.sleep(min(pause_s, max(0, end_ns - clock.monotonic_ns()) / 1e9))
    raise AssertionError("it takes its turns without a pause")
