"""The golden frames of the bundle in use, scored again every hour: a machine that computes differently is found.

One frame per turn, and only while nothing presses the gel, so that no press waits for more than one frame's score.
"""

from concurrent.futures import Future
from typing import Final

from edge.core.errors import BundleCorrupt
from edge.core.ports import Clock
from edge.model.inspector import Inspector

__all__ = ["GOLDEN_EVERY_S", "GoldenWatch"]

GOLDEN_EVERY_S: Final = 3600.0
# After a fault they are scored again sooner: it may have been the memory of one moment.
AFTER_FAULT_S: Final = 60.0


class GoldenWatch:
    """`watch` a bundle from now on, then `step` in every turn. fault: why its scores cannot be trusted, or None."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._inspector: Inspector | None = None
        self._number = 0
        self._next_ns = 0
        self._asked: list[Future[str | None]] = []
        self.fault: str | None = None

    def watch(self, inspector: Inspector, *, is_checked: bool = False) -> None:
        """Another bundle is in use. is_checked: its frames were scored just now."""
        self._inspector = inspector
        self._number = 0
        self.fault = inspector.fault  # of when it was in use before, until its frames score well
        self._next_ns = self._clock.monotonic_ns() + (round(GOLDEN_EVERY_S * 1e9) if is_checked else 0)

    def request(self) -> "Future[str | None]":
        """Score all frames with the next turns; the result is `fault` after the last one."""
        self._number, self._next_ns = 0, self._clock.monotonic_ns()
        self._asked.append(Future())
        return self._asked[-1]

    def step(self) -> bool:
        """Score one golden frame, if it is time; returns whether `fault` has changed."""
        if self._inspector is None or self._clock.monotonic_ns() < self._next_ns:
            return False
        fault = None
        try:
            if self._number < len(self._inspector.bundle.golden):
                self._inspector.scorer.check_golden_frame(self._number)
                self._number += 1
                if self._number < len(self._inspector.bundle.golden):
                    return False
        except BundleCorrupt as error:
            fault = str(error)
        self._number = 0
        self._next_ns = self._clock.monotonic_ns() + round((AFTER_FAULT_S if fault else GOLDEN_EVERY_S) * 1e9)
        before, self.fault = self.fault, fault
        for asked in self._asked:
            if asked.set_running_or_notify_cancel():
                asked.set_result(fault)
        self._asked.clear()
        return before != fault

    def close(self) -> None:
        """Nothing is scored any more."""
        for asked in self._asked:
            asked.cancel()
