"""The ports that plugins open. Each has one or two verbs; optional abilities are separate protocols."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from edge.core.imaging.frames import CameraFrame

__all__ = [
    "Clock",
    "CountsStale",
    "Device",
    "DeviceIdentity",
    "DiscoveredDevice",
    "Message",
    "OnDemand",
    "ReportsFaults",
    "Sink",
]


class Clock(Protocol):
    """Time, injected. `monotonic_ns` orders events; `time_ns` is the wall clock written into payloads, and fits into 64
    bits."""

    def monotonic_ns(self) -> int: ...
    def time_ns(self) -> int: ...
    def sleep(self, seconds: float) -> None: ...


@dataclass(frozen=True)
class DeviceIdentity:
    """The sensor's identity: `serial` is the key of the gel ledger. `mode` is (width, height) of its frames."""

    product: str
    serial: str
    mode: tuple[int, int]
    nominal_fps: float


@dataclass(frozen=True)
class DiscoveredDevice:
    """One thing found by a device plugin: a sensor, or something similar that is refused."""

    place: str
    """Where it is, such as `bus 1 port 2 address 7` or a folder."""
    product: str
    identity: DeviceIdentity | None = None
    """The identity of a sensor that can be opened."""
    refusal: str | None = None
    """Why it cannot be opened, as one sentence."""

    def __post_init__(self) -> None:
        if (self.identity is None) == (self.refusal is None):
            raise ValueError("a discovered device has an identity or a refusal, and not both")


@runtime_checkable
class Device(Protocol):
    """A source of camera frames. A frame is new or it is an error; no frame is delivered twice.

    Optional: `OnDemand`, `CountsStale`.
    """

    @property
    def identity(self) -> DeviceIdentity: ...

    def read(self, deadline_ns: int) -> CameraFrame:
        """The next new frame, waiting until the monotonic deadline.

        Errors: DeviceStalled at the deadline, DeviceLost when unplugged, FrameCorrupt for one bad frame,
        RecordingEnded when a recording is over. After DeviceLost only `close` is allowed.
        """

    def close(self) -> None:
        """Release everything. May be called again."""


@runtime_checkable
class OnDemand(Protocol):
    """A device that may make frames as fast as they are read; then the reader waits instead of dropping frames."""

    @property
    def on_demand(self) -> bool: ...


@runtime_checkable
class CountsStale(Protocol):
    """A device that counts the frames which came a second time and were left out."""

    @property
    def stale(self) -> int: ...


@dataclass(frozen=True)
class Message:
    """One message to publish."""

    topic: str
    """Relative to the station's root, such as `result`; the full one for a connection to a broker."""
    payload: bytes
    qos: int = 1
    retain: bool = False
    content_type: str = "application/json"
    """Empty for a payload whose kind is not told."""
    expiry_s: int | None = None
    correlation: bytes | None = None
    """Of the request that it answers."""


@runtime_checkable
class Sink(Protocol):
    """A receiver of messages, such as an MQTT broker. Optional: `ReportsFaults`."""

    def send(self, message: Message) -> None:
        """Deliver, and return only when acknowledged. Errors: SinkUnavailable, SinkRejected."""

    def close(self) -> None:
        """Disconnect properly. May be called again."""


@runtime_checkable
class ReportsFaults(Protocol):
    """A sink that works, but with faults that a person should correct; they become the alarm `receiver`."""

    @property
    def faults(self) -> Sequence[str]:
        """List the faults, one sentence for each; empty without a fault. Any thread may read it."""
