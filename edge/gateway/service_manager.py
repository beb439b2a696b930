"""Messages to systemd: ready, alive, stopping. Without systemd, or for a unit that does not ask, nothing is sent.

Ref: sd_notify(3): datagrams to the socket named in NOTIFY_SOCKET; WATCHDOG_USEC is the longest silence in microseconds.
"""

import contextlib
import os
import socket
from collections.abc import Mapping

from edge.core.ports import Clock

__all__ = ["ServiceManager"]


class ServiceManager:
    """Fed by the loop's own thread: a thread of its own would report a loop that hangs as alive."""

    def __init__(self, clock: Clock, environment: Mapping[str, str] = os.environ) -> None:
        self._clock = clock
        self._address = environment.get("NOTIFY_SOCKET", "")
        microseconds = environment.get("WATCHDOG_USEC", "")
        self._every_ns = int(microseconds) * 1000 // 3 if microseconds.isdecimal() else None
        self._last_ns: int | None = None

    def ready(self) -> None:
        """The gateway runs."""
        self._send("READY=1")

    def alive(self) -> None:
        """The loop has made a turn; sent three times in the longest silence."""
        now_ns = self._clock.monotonic_ns()
        if self._every_ns is None or (self._last_ns is not None and now_ns - self._last_ns < self._every_ns):
            return
        self._last_ns = now_ns
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """The gateway ends on purpose."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if not self._address.startswith(("/", "@")):
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as to:
            to.setblocking(False)  # a manager that does not read must not stop the loop
            to.sendto(message.encode(), address)
