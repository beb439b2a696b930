"""Waits for what other threads and programs do."""

import time
from collections.abc import Callable

__all__ = ["PATIENCE_S", "wait_until"]

# Far more than a busy machine needs: only what never comes is waited for so long.
PATIENCE_S = 60.0


def wait_until(is_so: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.005)
