"""The owner of one pedal or button: reads it, debounces it, and reports presses."""

import random
import threading
from collections.abc import Callable
from typing import Final

from edge.core.backoff import Backoff
from edge.core.digital_io import Trigger
from edge.core.ports import Clock
from edge.features.outputs.connection import FIRST_PAUSE_S, LONGEST_PAUSE_S, Connection, OnFault
from edge.features.outputs.rules import Debounce

__all__ = ["TriggerReader"]

# Reads are this short, so that closing does not wait, and presence is polled in time.
_LONGEST_READ_NS: Final = 250_000_000


class TriggerReader:
    """Owns the device from `start` to `close`. on_press: called once per press, from the owner thread.

    `step` is one turn of the owner without its thread; a test may call it instead of `start`.
    """

    def __init__(
        self,
        open_trigger: Callable[[], Trigger],
        clock: Clock,
        on_press: Callable[[], None],
        on_fault: OnFault,
        *,
        debounce_ns: int,
        backoff: Backoff | None = None,
    ) -> None:
        pauses = backoff or Backoff(random.Random(), FIRST_PAUSE_S, LONGEST_PAUSE_S)
        self._connection = Connection(open_trigger, clock, pauses, on_fault)
        self._clock, self._on_press, self._debounce_ns = clock, on_press, debounce_ns
        self._debounce = Debounce(debounce_ns)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="trigger", daemon=True)

    def start(self) -> None:
        """Begin to connect and read, in the background."""
        self._thread.start()

    def step(self) -> float:
        """Read once, or try to open; returns the seconds to wait before the next step, 0 for at once."""
        try:
            trigger = self._connection.open()
            if trigger is not None:
                self._read(trigger)
                self._connection.works()
                return 0.0
        except Exception as error:  # noqa: BLE001 - the owner's edge: any fault becomes an alarm
            self._debounce = Debounce(self._debounce_ns)  # held down or not: nothing is known of the next one
            self._connection.lost(error)
        return max(0.0, (self._connection.retry_ns - self._clock.monotonic_ns()) / 1e9)

    def _read(self, trigger: Trigger) -> None:
        self._connection.check_presence()
        now_ns = self._clock.monotonic_ns()
        due_ns = self._debounce.due_ns()
        longest_ns = now_ns + _LONGEST_READ_NS
        change = trigger.read(longest_ns if due_ns is None else min(max(due_ns, now_ns), longest_ns))
        if self._debounce.step(change, self._clock.monotonic_ns()):
            self._on_press()

    def _run(self) -> None:
        while not self._closing.is_set():
            pause_s = self.step()
            if pause_s:
                self._closing.wait(pause_s)
        self._connection.close()  # by its owner: closing during a read hangs in hidapi

    def close(self) -> None:
        """Stop reading and release the device; may be called again."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._connection.close()
