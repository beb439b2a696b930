"""Notices steps of the wall clock, by comparing it with the monotonic clock."""

from typing import Final

from edge.core.ports import Clock

__all__ = ["ClockGuard"]

# A time server that slews a clock moves it by at most 0.5 ms a second; more than this in 10 s is a step.
STEP_NS: Final = 2 * 10**9


class ClockGuard:
    """Call `step` now and then."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._apart_ns = self._now_apart_ns()

    def step(self) -> float | None:
        """The seconds by which the wall clock was set since the last call, None if it was not."""
        apart_ns = self._now_apart_ns()
        step_ns, self._apart_ns = apart_ns - self._apart_ns, apart_ns
        return step_ns / 1e9 if abs(step_ns) > STEP_NS else None

    def _now_apart_ns(self) -> int:
        return self._clock.time_ns() - self._clock.monotonic_ns()
