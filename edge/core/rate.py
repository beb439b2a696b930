"""At most a number of events a minute, at once or evenly."""

import threading

from edge.core.ports import Clock

__all__ = ["Rate"]


class Rate:
    """At most this number of events a minute. Any thread may use it."""

    def __init__(self, per_minute: int, clock: Clock) -> None:
        self._per_minute = per_minute
        self._clock = clock
        self._left = float(per_minute)
        self._seen_ns = clock.monotonic_ns()
        self._lock = threading.Lock()

    @property
    def is_exhausted(self) -> bool:
        """True where no event is allowed now; it takes none."""
        with self._lock:
            self._gain()
            return self._left < 1

    def take(self) -> bool:
        """Take one event; False where no more is allowed now."""
        with self._lock:
            self._gain()
            if self._left < 1:
                return False
            self._left -= 1
            return True

    def _gain(self) -> None:
        now_ns = self._clock.monotonic_ns()
        gained = max(0, now_ns - self._seen_ns) / 60e9 * self._per_minute
        self._left = min(float(self._per_minute), self._left + gained)
        self._seen_ns = now_ns
