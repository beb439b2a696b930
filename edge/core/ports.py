"""The ports: what plugins open. Each has one or two verbs; optional abilities are protocols of their own."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from edge.core.imaging.frames import CameraFrame

__all__ = [
    "Clock",
    "CountsStale",
    "Device",
    "DeviceIdentity",
    "Message",
    "OnDemand",
    "Sighting",
    "Sink",
]


class Clock(Protocol):
    """Time, injected. `monotonic_ns` orders events; `time_ns` is the wall clock written into payloads."""

    def monotonic_ns(self) -> int: ...
    def time_ns(self) -> int: ...
    def sleep(self, seconds: float) -> None: ...


@dataclass(frozen=True)
class DeviceIdentity:
    """Who the sensor is: `serial` keys the gel ledger. `mode` is (width, height) of the camera's own frames."""

    product: str
    serial: str
    mode: tuple[int, int]
    nominal_fps: float


@dataclass(frozen=True)
class Sighting:
    """One thing that a device plugin found when it looked: a sensor, or what looks like one and is refused.

    place: where it is, such as `bus 1 port 2 address 7` or a folder. identity: who it is, when it is a sensor that
    can be opened. refusal: why it is not, as one sentence.
    """

    place: str
    product: str
    identity: DeviceIdentity | None = None
    refusal: str | None = None

    def __post_init__(self) -> None:
        if (self.identity is None) == (self.refusal is None):
            raise ValueError("a sighting has an identity or a refusal, and not both")


@runtime_checkable
class Device(Protocol):
    """A source of camera frames. A frame is new or it is an error; nothing is ever delivered twice.

    Optional: `OnDemand`, `CountsStale`.
    """

    @property
    def identity(self) -> DeviceIdentity: ...

    def read(self, deadline_ns: int) -> CameraFrame:
        """The next new frame, waiting until the monotonic deadline.

        Errors: DeviceStalled at the deadline, DeviceLost when unplugged, FrameCorrupt for one bad frame,
        RecordingEnded when a recording is over. After DeviceLost only `close` is allowed.
        """
        ...

    def close(self) -> None:
        """Give everything back; harmless when repeated."""
        ...


@runtime_checkable
class OnDemand(Protocol):
    """A device that may make frames as fast as they are read; then the reader waits instead of dropping."""

    @property
    def on_demand(self) -> bool: ...


@runtime_checkable
class CountsStale(Protocol):
    """A device that counts the frames which came a second time and were left out."""

    @property
    def stale(self) -> int: ...


@dataclass(frozen=True)
class Message:
    """One thing to be published. `topic` is relative to the station's root, such as `result`."""

    topic: str
    payload: bytes
    qos: int = 1
    retain: bool = False
    content_type: str = "application/json"
    expiry_s: int | None = None


@runtime_checkable
class Sink(Protocol):
    """A receiver of messages, such as an MQTT broker."""

    def send(self, message: Message) -> None:
        """Deliver, and return only when acknowledged. Errors: SinkUnavailable, SinkRejected."""
        ...

    def close(self) -> None:
        """Say goodbye properly; harmless when repeated."""
        ...
