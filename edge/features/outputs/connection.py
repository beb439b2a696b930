"""A pedal or relay that may disappear: opened again with pauses, and its presence polled.

A HID device that was unplugged reads as silent, without an error (hidapi 0.15 on Linux), so that only a search tells.
"""

import logging
import random
from collections.abc import Callable
from typing import Final, Generic, Protocol, TypeVar

from edge.core.backoff import Backoff
from edge.core.errors import DeviceError, DeviceLost
from edge.core.ports import Clock
from edge.core.sentence import Sentence

__all__ = ["Connection", "OnFault"]

log = logging.getLogger(__name__)

OnFault = Callable[[str | None], None]
"""Called with the reason while a device cannot be used, and with None while it can."""

_FIRST_PAUSE_S: Final = 0.5
_LONGEST_PAUSE_S: Final = 5.0
_PRESENCE_NS: Final = 1_000_000_000


class _Port(Protocol):
    @property
    def name(self) -> str: ...
    def is_present(self) -> bool: ...
    def close(self) -> None: ...


P = TypeVar("P", bound=_Port)


class Connection(Generic[P]):
    """One device of its owner thread. `port` is None while it is away, and `retry_ns` then says when to try again.
    `fault`: why it cannot be used, until it works."""

    def __init__(self, open_port: Callable[[], P], clock: Clock, backoff: Backoff | None) -> None:
        self.port: P | None = None
        self.fault: str | None = None
        self.retry_ns = clock.monotonic_ns()
        self._check_ns = 0
        self._open_port, self._clock = open_port, clock
        self._backoff = backoff or Backoff(random.Random(), _FIRST_PAUSE_S, _LONGEST_PAUSE_S)

    def open(self) -> P | None:
        """The device, opened where it is time to try; None while it is away. Once a second it must still be there.
        Errors: DeviceError, DeviceLost when it is gone."""
        now_ns = self._clock.monotonic_ns()
        if self.port is None:
            if now_ns < self.retry_ns:
                return None
            self.port = self._open_port()
        elif now_ns < self._check_ns:
            return self.port
        elif not self.port.is_present():
            raise DeviceLost(Sentence(f"{self.port.name} is gone; plug it in again"))
        self._check_ns = now_ns + _PRESENCE_NS
        return self.port

    def works(self) -> None:
        """The device did what it was asked for."""
        self._backoff.succeeded()
        self.fault = None

    def lost(self, error: Exception) -> None:
        """Close it, and note why and when to try again. A fault of a driver does not end its owner: that would be a
        silence."""
        self.fault = str(error)
        if not isinstance(error, DeviceError):
            self.fault = Sentence(f"its driver failed: {error!r}; see the log")
            log.error("the driver failed", exc_info=error)
        self.close()
        self.retry_ns = self._clock.monotonic_ns() + round(self._backoff.failed() * 1e9)

    def close(self) -> None:
        """Release the device; may be called again. One that is gone may fail at it, and its owner goes on."""
        port, self.port = self.port, None
        if port is None:
            return
        try:
            port.close()
        except Exception:
            log.exception("%s cannot be closed", port.name)
