"""The real clock. Tests pass their own."""

import time

__all__ = ["SystemClock"]


class SystemClock:
    """Time as the machine tells it."""

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    def time_ns(self) -> int:
        return time.time_ns()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)
