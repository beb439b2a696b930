"""Reads frames from a sensor that may disconnect: one reader thread, one bounded queue.

The thread always drains the sensor. A consumer that is too far behind gets the newest frame, and the frames before it
are dropped together and counted. Dropping one for each new frame would keep the consumer behind for ever. After any
fault the thread opens the sensor again, with growing pauses.
"""

import logging
import random
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Self

from edge.core.backoff import Backoff
from edge.core.errors import DeviceError, DeviceNotFound, DeviceStalled, FrameCorrupt, RecordingEnded
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import Freshness
from edge.core.ports import Clock, CountsStale, Device, DeviceIdentity, OnDemand
from edge.core.sentence import Sentence

__all__ = ["Acquisition", "AcquisitionState", "AcquisitionStatus"]

log = logging.getLogger(__name__)

# A driver returns from each call within a quarter of a second, or when its sensor is open. One that does not hangs.
STUCK_S: Final = 5.0
# Frames over which the delivered rate is taken: two seconds at 18.75 fps.
_RATE_FRAMES = 38
# Bad frames in sequence for `stall_after_s` are a fault of the stream; after a pause of this computer it takes so many.
_CORRUPT_IN_A_ROW = 4
_LONGEST_WAIT_NS = 250_000_000
# Pauses between two attempts to open the sensor.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 10.0
# A consumer this far behind gets the newest frame. A frame older than 1 s is refused when it is judged, and the judged
# frame of a press may be some frames older than the frame that ends the wait.
_LONGEST_BACKLOG_NS = 800_000_000


class AcquisitionState(Enum):
    """A sensor streams once it gives a frame; one that is opened again and repeats its last frame is still a fault."""

    CONNECTING = "connecting"
    STREAMING = "streaming"
    FAULT = "fault"
    ENDED = "ended"
    CLOSED = "closed"


@dataclass(frozen=True)
class AcquisitionStatus:
    """What the reader thread has seen so far.

    corrupt, stale: frames refused.
    """

    state: AcquisitionState = AcquisitionState.CONNECTING
    identity: DeviceIdentity | None = None
    fault: str | None = None
    """Why there are no frames now, or None."""
    frames: int = 0
    """Delivered by the sensor."""
    corrupt: int = 0
    stale: int = 0
    dropped: int = 0
    """Delivered, but not taken in time."""
    reconnects: int = 0
    """Successful openings after the first."""
    fps: float = 0.0
    """Delivered rate of the last two seconds, 0.0 until known."""


class Acquisition:
    """Owns the sensor from `start` to `close`. A context manager starts and closes it.

    open_device: makes one attempt. on_change: called from the reader thread with the status, once per change of state
    or fault, and from `next` where a driver does not return; it must return soon. depth: frames kept for a slow
    consumer, at most 0.8 s of them.
    stall_after_s: after this time without a new frame the sensor is opened again. backoff: the pauses between attempts;
    by default the first is at most 0.5 s and the longest 10 s.

    A reconnection is to the same sensor: one with another serial is refused as a fault.
    `step` is one turn of the reader without its thread; a test may call it instead of `start`.
    `CameraFrame.sequence` rises over reconnections; a gap means that frames were lost, refused or dropped there.
    """

    def __init__(
        self,
        open_device: Callable[[], Device],
        clock: Clock,
        on_change: Callable[[AcquisitionStatus], None] | None = None,
        *,
        depth: int = 32,
        stall_after_s: float = 2.0,
        backoff: Backoff | None = None,
    ) -> None:
        if depth < 1 or stall_after_s <= 0:
            raise ValueError(f"depth and stall time are positive, found {depth} and {stall_after_s}")
        self._open_device, self._clock, self._on_change = open_device, clock, on_change
        self._depth, self._stall_ns = depth, round(stall_after_s * 1e9)
        self._backoff = backoff or Backoff(random.Random(), _FIRST_PAUSE_S, _LONGEST_PAUSE_S)
        self._frames: deque[CameraFrame] = deque()
        self._times_ns: deque[int] = deque(maxlen=_RATE_FRAMES)
        self._changed = threading.Condition(threading.RLock())  # `_deliver` holds it while it calls `_set`
        self._closing = threading.Event()
        self._status = AcquisitionStatus()
        self._ending: BaseException | None = None
        self._sequence = -1
        self._freshness = Freshness()  # of all openings: a camera that hangs still has its last frame
        self._stale_before = 0
        self._counting: CountsStale | None = None
        self._is_waiting = False  # for the consumer, instead of dropping
        self._openings = 0
        self._device: Device | None = None
        self._corrupt_in_a_row = 0
        self._began_ns: int | None = None  # the step that the reader takes now
        self._last_ns = 0  # of the last frame, or of the opening
        self._thread = threading.Thread(target=self._run, name="acquisition", daemon=True)

    def start(self) -> None:
        """Begin to connect and read, in the background."""
        self._thread.start()

    @property
    def status(self) -> AcquisitionStatus:
        with self._changed:
            return self._status

    def next(self, timeout_s: float) -> CameraFrame | None:
        """The oldest frame not yet taken, or None when no frame came in time.

        Errors: RecordingEnded when a recording is over and all its frames were taken; any exception of the reader
        thread that is not a device's fault.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._frames or self._ending, timeout_s)
            if self._frames:
                frame = self._frames.popleft()
                self._changed.notify_all()
                return frame
            if self._ending is not None:
                raise self._ending
        self._watch_reader()
        return None

    def _watch_reader(self) -> None:
        """Report a driver that does not return: its thread cannot, and the last verdict would stand as of now."""
        began_ns, is_streaming = self._began_ns, self._status.state is AcquisitionState.STREAMING
        if began_ns is not None and is_streaming and self._clock.monotonic_ns() - began_ns > STUCK_S * 1e9:
            stuck = Sentence("the sensor's driver does not return; unplug the sensor and plug it in again")
            self._set(state=AcquisitionState.FAULT, fault=stuck)

    def close(self) -> None:
        """Stop reading and release the sensor; may be called again."""
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join(STUCK_S)
        if self._thread.is_alive():  # inside the driver, which no other thread may close then
            log.error("the sensor's driver does not return; the sensor is left as it is")
        else:
            self._give_back()
        self._set(state=AcquisitionState.CLOSED, fault=None)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # The reader thread

    def step(self) -> float:
        """Open the sensor, or read one frame; returns the seconds to wait before the next step, 0 for at once.

        Faults of the sensor go to `status`, and the sensor is opened again. Errors: RecordingEnded; any exception that
        is not a device's fault.
        """
        try:
            if self._device is None:
                self._open()
            elif self._has_room():
                self._read(self._device)
        except RecordingEnded:
            self._give_back()
            raise
        except DeviceError as error:
            self._give_back()
            self._set(state=AcquisitionState.FAULT, fault=str(error), fps=0.0)
            return self._backoff.failed()
        except BaseException:
            self._give_back()
            raise
        return 0.0

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._await_room()
                self._began_ns = self._clock.monotonic_ns()
                pause_s = self.step()
                self._began_ns = None
                if pause_s:
                    self._closing.wait(pause_s)
        except RecordingEnded as error:
            self._finish(error, AcquisitionState.ENDED, None)
        except BaseException as error:  # noqa: BLE001 - the loop's edge: it is raised again in `next`
            self._finish(error, AcquisitionState.FAULT, str(error))

    def _finish(self, error: BaseException, state: AcquisitionState, fault: str | None) -> None:
        """The state first: a consumer that gets the error in `next` finds its state in `status`."""
        try:
            self._set(state=state, fault=fault)
        finally:
            with self._changed:
                self._ending = error
                self._changed.notify_all()

    def _open(self) -> None:
        device = self._open_device()
        self._device = device
        self._welcome(device)
        self._corrupt_in_a_row, self._last_ns = 0, self._clock.monotonic_ns()

    def _read(self, device: Device) -> None:
        """Read once. Waits are short, so that `close` does not wait for a stalled sensor.

        The time without a frame ends with a read that waited: after a pause of this computer frames are there.
        """
        stalled_ns = self._last_ns + self._stall_ns
        try:
            frame = device.read(self._clock.monotonic_ns() + _LONGEST_WAIT_NS)
        except FrameCorrupt:
            self._corrupt_in_a_row += 1
            self._sequence += 1
            self._set(corrupt=self._status.corrupt + 1)
            self._count_stale()
            if self._corrupt_in_a_row >= _CORRUPT_IN_A_ROW and self._clock.monotonic_ns() >= stalled_ns:
                raise
            return
        except DeviceStalled:
            if self._clock.monotonic_ns() >= stalled_ns:
                raise
            return
        self._corrupt_in_a_row = 0
        if not self._freshness.is_new(frame.payload):
            if self._clock.monotonic_ns() >= stalled_ns:
                raise DeviceStalled(
                    Sentence(f"{device.identity.product} repeats one frame; unplug it and plug it in again")
                )
            return
        self._deliver(frame)
        self._backoff.succeeded()
        self._last_ns = self._clock.monotonic_ns()
        if self._status.state is not AcquisitionState.STREAMING:
            self._set(state=AcquisitionState.STREAMING, fault=None)

    def _give_back(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            self._count_stale()
            self._stale_before, self._counting = self._status.stale, None
            device.close()

    def _has_room(self) -> bool:
        """False where the consumer must take a frame first: a device that waits for its reader loses no frame."""
        return not self._is_waiting or len(self._frames) < self._depth

    def _await_room(self) -> None:
        """A wait for the consumer is not the sensor's silence: the time without a frame begins after it."""
        with self._changed:
            if self._has_room():
                return
            self._changed.wait_for(lambda: self._has_room() or self._closing.is_set())
        self._last_ns = self._clock.monotonic_ns()

    def _welcome(self, device: Device) -> None:
        known = self._status.identity
        if known is not None and device.identity.serial != known.serial:
            raise DeviceNotFound(
                Sentence(
                    f"sensor {known.serial} is gone and {device.identity.serial} is plugged in instead; put the first "
                    "one back, or restart to go on with the other: wear is counted for each sensor's own gel"
                )
            )
        self._openings += 1
        self._counting = device if isinstance(device, CountsStale) else None
        self._is_waiting = isinstance(device, OnDemand) and device.on_demand
        self._times_ns.clear()
        self._sequence += 1  # frames missed while it was away leave a gap
        self._set(identity=device.identity, reconnects=self._openings - 1)

    def _deliver(self, frame: CameraFrame) -> None:
        self._times_ns.append(frame.timestamp_ns)
        with self._changed:
            self._sequence += 1
            self._frames.append(frame.renumber(self._sequence))
            dropped = self._status.dropped + self._shortened()
            self._set(frames=self._status.frames + 1, dropped=dropped, fps=self._rate())
            self._changed.notify_all()
        self._count_stale()

    def _shortened(self) -> int:
        """Keep only the newest frame where the consumer is too far behind; returns how many were dropped."""
        behind_ns = self._frames[-1].timestamp_ns - self._frames[0].timestamp_ns
        if len(self._frames) <= self._depth and (self._is_waiting or behind_ns <= _LONGEST_BACKLOG_NS):
            return 0
        dropped = len(self._frames) - 1
        self._frames = deque([self._frames[-1]])
        return dropped

    def _rate(self) -> float:
        if len(self._times_ns) < 2 or self._times_ns[-1] == self._times_ns[0]:
            return 0.0
        return (len(self._times_ns) - 1) * 1e9 / (self._times_ns[-1] - self._times_ns[0])

    def _count_stale(self) -> None:
        stale = self._stale_before + (self._counting.stale if self._counting is not None else 0)
        if stale != self._status.stale:
            self._set(stale=stale)

    def _set(self, **changes: object) -> None:
        """Change the status, and report it when the state or the fault differs from before."""
        with self._changed:
            before = self._status
            self._status = replace(before, **changes)  # type: ignore[arg-type]  # field names, checked by replace
            now = self._status
        if self._on_change is not None and (now.state, now.fault) != (before.state, before.fault):
            self._on_change(now)
