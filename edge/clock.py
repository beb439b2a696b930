"""The real clock, one for tests, and how a person reads a time."""

import threading
import time
from datetime import UTC, date, datetime
from typing import Final

__all__ = ["ManualClock", "SystemClock", "local_day", "local_time"]

# 1 January 2262: the last year that nanoseconds in 64 bits reach, as the database keeps them, ends on 11 April.
_LATEST_NS: Final = 9_214_646_400 * 10**9
_DAY_NS: Final = 86_400 * 10**9


class SystemClock:
    """Time as the machine tells it."""

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    def time_ns(self) -> int:
        """A clock beyond 2262 is wrong, and its time cannot be kept: it becomes its time of day on that day."""
        now_ns = time.time_ns()
        return min(now_ns, _LATEST_NS + now_ns % _DAY_NS)

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class ManualClock:
    """Time that passes only while somebody sleeps, for tests of a plugin; threads can share it."""

    def __init__(self, now_ns: int = 1_000_000_000) -> None:
        self._now_ns = now_ns
        self._guard = threading.Lock()

    def monotonic_ns(self) -> int:
        with self._guard:
            return self._now_ns

    def time_ns(self) -> int:
        return self.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        with self._guard:
            self._now_ns += round(seconds * 1e9)


def local_time(time_ns: int) -> str:
    """Write a wall-clock moment for a person: local time with its offset, such as `2026-01-31 09:07:19+09:00`.

    What programs read has UTC (`edge.messaging.payload_base.iso_time`).
    """
    return datetime.fromtimestamp(time_ns // 1_000_000_000, UTC).astimezone().isoformat(" ")


def local_day(time_ns: int) -> date:
    """Give the day of a wall-clock moment, by this machine's local time."""
    return datetime.fromtimestamp(time_ns // 1_000_000_000).date()
