"""The owner of one pedal or button: reads it, debounces it, and reports presses."""

import threading
from collections.abc import Callable
from typing import Final

from edge.core.backoff import Backoff
from edge.core.digital_io import Trigger
from edge.core.ports import Clock
from edge.features.outputs.connection import Connection, OnFault

__all__ = ["Debounce", "TriggerReader"]

# Reads are this short, so that closing does not wait, and presence is polled in time.
_LONGEST_READ_NS: Final = 250_000_000
CLOSE_S: Final = 5.0


class Debounce:
    """From the changes of a contact to presses: down for `hold_ns`, then up for `hold_ns` before the next one."""

    def __init__(self, hold_ns: int) -> None:
        self._hold_ns = hold_ns
        self._is_down = False
        self._since_ns = 0
        self._has_fired = False

    def step(self, change: bool | None, now_ns: int) -> bool:
        """True once for each press."""
        if change is not None and change != self._is_down:
            self._is_down, self._since_ns = change, now_ns
        if self._is_down == self._has_fired or now_ns - self._since_ns < self._hold_ns:
            return False
        self._has_fired = self._is_down
        return self._is_down

    def due_ns(self) -> int | None:
        """When `step` must be called again although nothing changes; None where only a change matters."""
        return None if self._is_down == self._has_fired else self._since_ns + self._hold_ns


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
        self._connection = Connection(open_trigger, clock, backoff)
        self._clock, self._on_press, self._on_fault = clock, on_press, on_fault
        self._debounce_ns = debounce_ns
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
        except Exception as error:  # noqa: BLE001 - the owner's edge: any fault becomes an alarm
            self._debounce = Debounce(self._debounce_ns)  # held down or not: nothing is known of the next one
            self._connection.lost(error)
        self._on_fault(self._connection.fault)
        if self._connection.port is not None:
            return 0.0
        return max(0.0, (self._connection.retry_ns - self._clock.monotonic_ns()) / 1e9)

    def _read(self, trigger: Trigger) -> None:
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
            self._thread.join(CLOSE_S)
        if not self._thread.is_alive():  # else a read does not end, and closing during it would neither
            self._connection.close()
