"""A recording played directly from its folder, without USB: the quickest way to replay frames.

It delivers the recorded bytes at the recorded intervals or, with pace 0, as fast as they are read. It does not simulate
a bus, a driver or a fault; use `usb_mock` for those.
"""

from pathlib import Path

from pydantic import BaseModel, Field

from edge.core.errors import DeviceLost, DeviceStalled, FrameCorrupt, RecordingEnded, RecordingError
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import Freshness, damage
from edge.core.plugins import DevicePlugin
from edge.core.ports import Clock, Device, DiscoveredDevice
from edge.recording.format import Recording

__all__ = ["Recorded", "RecordedOptions", "RecordedSensor", "plugin"]


class RecordedOptions(BaseModel, extra="forbid", frozen=True):
    """Which recording, and how it is played."""

    recording: Path = Field(
        description="the folder to play, made by `gelgate record` or `gelgate lab simulate`"
    )
    pace: float = Field(
        default=1.0,
        ge=0,
        le=1000,
        description="1 plays at the recorded times, 2 twice as fast, 0 as fast as frames are read; with 0 frames "
        "have the recorded times, so contact is found as in real time and no frame is dropped",
    )
    loop: bool = Field(default=False, description="start again at the end")


class RecordedSensor:
    """A recording as a `Device`. `stale` counts the frames that repeat the one before; they are left out."""

    def __init__(self, recording: Recording, clock: Clock, *, pace: float, loop: bool) -> None:
        self.identity = recording.header.identity
        self.on_demand = pace == 0
        self._recording, self._clock, self._pace, self._loop = recording, clock, pace, loop
        self._times_ns = recording.times_ns()
        self._pause_ns = recording.gaps_ns()[0]  # between the last frame and the first one again
        self._freshness = Freshness()
        self._position = 0
        self._sequence = 0
        self._start_ns = clock.monotonic_ns()
        self._gone: str | None = None

    @property
    def stale(self) -> int:
        return self._freshness.stale

    def read(self, deadline_ns: int) -> CameraFrame:
        """The next frame that differs from the last one (see `Device.read`)."""
        while True:
            if self._gone is not None:
                raise DeviceLost(self._gone)
            self._await_frame(deadline_ns)
            payload = self._take()
            self._sequence += 1
            fault = damage(payload)
            if fault is not None:
                raise FrameCorrupt(f"recording {self._recording.folder}, frame {self._position - 1}: {fault}")
            if self._freshness.is_new(payload):
                return CameraFrame(payload, self._stamp_ns(), self._sequence - 1, self.on_demand)

    def _await_frame(self, deadline_ns: int) -> None:
        if self._position == len(self._recording):
            self._rewind()
        due_ns, now = self._due_ns(), self._clock.monotonic_ns()
        self._clock.sleep(max(min(due_ns, deadline_ns) - now, 0) / 1e9)
        if due_ns > deadline_ns:
            raise DeviceStalled(
                f"recording {self._recording.folder}: the next frame is not due before the deadline"
            )

    def _due_ns(self) -> int:
        if self._pace == 0:
            return 0
        return self._start_ns + round((self._times_ns[self._position] - self._times_ns[0]) / self._pace)

    def _stamp_ns(self) -> int:
        """When the last frame arrived; on demand, when it would have arrived in real time."""
        if self.on_demand:
            return self._start_ns + self._times_ns[self._position - 1] - self._times_ns[0]
        return self._clock.monotonic_ns()

    def _rewind(self) -> None:
        if not self._loop or not self._times_ns:
            raise RecordingEnded(
                f"recording {self._recording.folder} has ended after {len(self._recording)} frames"
            )
        self._position = 0
        length_ns = self._times_ns[-1] - self._times_ns[0] if self.on_demand else 0
        self._start_ns = max(self._clock.monotonic_ns(), self._start_ns + length_ns + self._pause_ns)

    def _take(self) -> bytes:
        try:
            payload = self._recording[self._position].frame.payload
        except RecordingError as error:
            self._gone = str(error)
            raise DeviceLost(self._gone) from error
        self._position += 1
        return payload

    def close(self) -> None:
        self._gone = self._gone or f"recording {self._recording.folder} was closed"


class Recorded(DevicePlugin[RecordedOptions]):
    """The plugin."""

    Options = RecordedOptions

    def discover(self, options: RecordedOptions) -> list[DiscoveredDevice]:
        try:
            header = Recording.open(options.recording).header
        except RecordingError as error:
            return [DiscoveredDevice(str(options.recording), "", refusal=str(error))]
        return [DiscoveredDevice(str(options.recording), header.product, header.identity)]

    def recording(self, options: RecordedOptions) -> Recording:
        return Recording.open(options.recording)

    def open(self, options: RecordedOptions, clock: Clock) -> Device:
        """Open the recording as a sensor. Errors: RecordingError."""
        return RecordedSensor(Recording.open(options.recording), clock, pace=options.pace, loop=options.loop)


plugin = Recorded()
