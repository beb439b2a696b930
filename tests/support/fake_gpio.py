"""The kernel's part of GPIO: lines with levels, edges that a test makes, and a chip that can be removed."""

import errno
from collections import deque
from collections.abc import Mapping
from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import gpiod

from edge.clock import ManualClock
from plugins.digital_io.gpio import Kernel

RISING, FALLING = gpiod.EdgeEvent.Type.RISING_EDGE, gpiod.EdgeEvent.Type.FALLING_EDGE


class FakeKernel(Kernel):
    """levels: what each line drives; None where it is an input. stuck: lines that keep their level."""

    def __init__(self, clock: ManualClock) -> None:
        self.clock = clock
        self.levels: dict[int, bool | None] = {}
        self.edges: deque[gpiod.EdgeEvent.Type] = deque()
        self.stuck: set[int] = set()
        self.is_plugged_in = True
        self.error: OSError | None = None
        self.releases = 0
        self.gone = errno.ENOENT

    def request(self, chip: str, settings: Mapping[int, Any]) -> Any:
        self.gone = errno.ENOENT
        self.check()
        self.gone = errno.ENODEV  # of lines that were requested before
        return FakeRequest(self)

    def is_output(self, chip: str, line: int) -> bool:
        self.check()
        return self.levels.get(line) is not None

    def has_chip(self, chip: str) -> bool:
        return self.is_plugged_in

    def check(self) -> None:
        if self.error is not None:
            raise self.error
        if not self.is_plugged_in:
            raise OSError(self.gone, "No such device")


class FakeRequest:
    """Requested lines."""

    def __init__(self, kernel: FakeKernel) -> None:
        self._kernel = kernel

    def get_value(self, line: int) -> gpiod.line.Value:
        self._kernel.check()
        return gpiod.line.Value(int(bool(self._kernel.levels.get(line))))

    def set_value(self, line: int, value: gpiod.line.Value) -> None:
        self._kernel.check()
        if line not in self._kernel.stuck:
            self._kernel.levels[line] = value == gpiod.line.Value.ACTIVE

    def reconfigure_lines(self, settings: Mapping[int, gpiod.LineSettings]) -> None:
        for line, one in settings.items():
            self.set_value(line, one.output_value)

    def wait_edge_events(self, timeout: timedelta) -> bool:
        self._kernel.check()
        if not self._kernel.edges:
            self._kernel.clock.sleep(timeout.total_seconds())
        return bool(self._kernel.edges)

    def read_edge_events(self) -> list[Any]:
        found = [SimpleNamespace(event_type=edge) for edge in self._kernel.edges]
        self._kernel.edges.clear()
        return found

    def release(self) -> None:
        self._kernel.releases += 1
