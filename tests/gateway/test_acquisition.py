"""The reader of the sensor: its counters, its messages, its reconnection, and its thread."""

import random
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from small_recordings import SERIAL, jpeg, write_recording
from waiting import PATIENCE_S, wait_until

from edge.acquisition import Acquisition, AcquisitionState, AcquisitionStatus
from edge.clock import ManualClock, SystemClock
from edge.core.backoff import Backoff
from edge.core.errors import (
    DeviceLost,
    DeviceNotFound,
    DeviceStalled,
    FrameCorrupt,
    RecordingEnded,
    RecordingError,
)
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Device, DeviceIdentity
from plugins.devices.usb_mock import UsbMockOptions, plugin

LOST, OVER = DeviceLost("pulled"), RecordingEnded("over")
FAULT, STREAMING, ENDED, CLOSED = (
    AcquisitionState(name) for name in ("fault", "streaming", "ended", "closed")
)


def options_for(tmp_path: Path, *faults: str, frames: int = 8) -> UsbMockOptions:
    recording = write_recording(tmp_path / "recording", frames)
    return UsbMockOptions(recording=recording, pace=0.0, faults=faults, with_webcam=False)


class ScriptedDevice:
    """Reads from a list: a payload, or an error to raise."""

    def __init__(self, clock: ManualClock, *script: bytes | Exception, serial: str = SERIAL) -> None:
        self.identity = DeviceIdentity("GelSight Mini R0B", serial, (64, 48), 25.0)
        self.closed = 0
        self._script, self._clock = list(script), clock

    def read(self, deadline_ns: int) -> CameraFrame:
        step = self._script.pop(0)
        if isinstance(step, Exception):
            raise step
        if deadline_ns <= self._clock.monotonic_ns():
            raise DeviceStalled("no time to look")
        self._clock.sleep(0.05)
        return CameraFrame(step, self._clock.monotonic_ns(), 0)

    def close(self) -> None:
        self.closed += 1


class Reader(Acquisition):
    """Opens these devices in turn, or raises; every step is the test's. said: each change of state and fault."""

    def __init__(self, clock: ManualClock, openings: Sequence[Device | Exception], depth: int = 32) -> None:
        self.said: list[tuple[AcquisitionState, str | None]] = []
        self.failures_in_a_row: list[int] = []
        openings, backoff = list(openings), Backoff(random.Random(0), 0.5, 10.0)

        def open_next() -> Device:
            self.failures_in_a_row.append(backoff.failures)
            opening = openings.pop(0)
            if isinstance(opening, Exception):
                raise opening
            return opening

        super().__init__(open_next, clock, self._note, depth=depth, backoff=backoff)

    def _note(self, status: AcquisitionStatus) -> None:
        self.said.append((status.state, status.fault))

    def read_all(self) -> None:
        """Step to the end of the recording."""
        with suppress(RecordingEnded):
            while True:
                self.step()

    def waiting(self) -> list[CameraFrame]:
        """Take the frames that wait."""
        return list(iter(lambda: self.next(0), None))


def all_frames(acquisition: Acquisition) -> list[bytes]:
    """Take every frame until the recording ends."""
    payloads = []
    with suppress(RecordingEnded):
        while (frame := acquisition.next(PATIENCE_S)) is not None:
            payloads.append(frame.payload)
    return payloads


@pytest.mark.parametrize(
    ("faults", "delivered", "corrupt", "stale", "reconnects"),
    [
        ((), range(8), 0, 0, 0),
        (("error_bit@1", "truncate@3", "stale@5"), (0, 2, 4, 6, 7), 2, 1, 0),
        (("stall@3",), range(8), 0, 0, 1),
    ],
)
def test_faults_are_counted_and_the_rest_arrives_in_order(
    tmp_path: Path,
    faults: tuple[str, ...],
    delivered: Sequence[int],
    corrupt: int,
    stale: int,
    reconnects: int,
) -> None:
    """Corrupt and stale frames are never delivered; a stream that stops is opened again, and loses no frame."""
    options, clock = options_for(tmp_path, *faults), ManualClock()
    with Acquisition(lambda: plugin.open(options, clock), clock, depth=3) as acquisition:
        assert all_frames(acquisition) == [jpeg(seed) for seed in delivered]
        status = acquisition.status
    assert (status.frames, status.dropped, status.state) == (len(delivered), 0, ENDED)
    assert (status.corrupt, status.stale, status.reconnects) == (corrupt, stale, reconnects)


@pytest.mark.parametrize(("frames", "depth", "kept"), [(10, 4, [9, 10]), (24, 32, list(range(18, 25)))])
def test_a_lagging_consumer_gets_the_newest(frames: int, depth: int, kept: list[int]) -> None:
    """One more than are kept, or older than 0.8 s: the newest alone stays, so the consumer is not left behind."""
    device = ScriptedDevice(clock := ManualClock(), *map(jpeg, range(frames)), OVER)
    reader = Reader(clock, [device], depth)
    reader.read_all()
    assert [frame.sequence for frame in reader.waiting()] == kept
    assert (reader.status.frames, reader.status.dropped) == (frames, frames - len(kept))
    assert reader.status.fps == pytest.approx(20.0)


@pytest.mark.parametrize("fps", [7, 25])
def test_two_seconds_of_broken_frames_are_a_fault_at_every_rate(fps: int) -> None:
    """A slow camera needs no 38 of them. After a pause of this computer the first broken frame is none yet."""
    clock = ManualClock()
    script = [jpeg(0), *[FrameCorrupt("half a frame")] * (2 * fps + 2)]
    reader = Reader(clock, [ScriptedDevice(clock, *script)])
    reader.step()
    reader.step()
    faults = []
    for _ in range(2 * fps + 2):
        clock.sleep(1 / fps)
        faults.append(reader.step() > 0)
        if faults[-1]:
            break
    assert faults == [*[False] * (len(faults) - 1), True]
    assert 2.0 <= len(faults) / fps < 2.0 + 2 / fps

    paused = Reader(clock, [ScriptedDevice(clock, jpeg(1), FrameCorrupt("half a frame"), jpeg(2))])
    paused.step()
    paused.step()
    clock.sleep(5)
    assert [paused.step(), paused.step()] == [0.0, 0.0]


def test_the_reader_steps_without_a_thread_and_without_time() -> None:
    """No sensor twice, a frame, a broken one, unplugged, opened again, a frame, and the end: in the order of the steps.
    Frames before and after a loss are not consecutive; each device is closed once; changes are said once."""
    clock = ManualClock()
    devices = [
        ScriptedDevice(clock, jpeg(0), FrameCorrupt("half a frame"), jpeg(1), LOST),
        ScriptedDevice(clock, jpeg(2), OVER),
    ]
    reader = Reader(clock, [DeviceNotFound("nothing"), DeviceNotFound("nothing"), *devices])
    pauses = [reader.step() for _ in range(9)]
    with pytest.raises(RecordingEnded):
        reader.step()
    taken = reader.waiting()
    reader.close()

    assert [pause > 0 for pause in pauses] == [True, True, *[False] * 4, True, False, False]
    assert reader.failures_in_a_row == [0, 1, 2, 1]
    assert [(frame.payload, frame.sequence) for frame in taken] == [(jpeg(0), 1), (jpeg(1), 3), (jpeg(2), 5)]
    assert (reader.status.corrupt, reader.status.reconnects) == (1, 1)
    assert [device.closed for device in devices] == [1, 1]
    assert reader.said == [
        (FAULT, "nothing"), (STREAMING, None), (FAULT, "pulled"), (STREAMING, None), (CLOSED, None)
    ]  # fmt: skip


def test_another_sensor_is_not_taken_for_the_first() -> None:
    """Plugged in while running: refused with both serials and closed, so wear is not counted on its gel."""
    clock = ManualClock()
    other = ScriptedDevice(clock, jpeg(1), serial="28D8PXEC")
    again = ScriptedDevice(clock, jpeg(2), OVER)
    reader = Reader(clock, [ScriptedDevice(clock, jpeg(0), LOST), other, again])
    reader.read_all()
    assert [frame.payload for frame in reader.waiting()] == [jpeg(0), jpeg(2)]
    assert (reader.status.reconnects, other.closed) == (1, 1)
    assert any(fault and SERIAL in fault and "28D8PXEC" in fault for _, fault in reader.said)


def test_a_pause_of_the_computer_is_not_the_sensors_silence() -> None:
    """Suspended for three seconds, or as busy: the frames that wait are read, and the sensor is not opened again."""
    clock = ManualClock()
    reader = Reader(clock, [ScriptedDevice(clock, jpeg(0), jpeg(1))])
    reader.step()
    reader.step()
    clock.sleep(3.0)
    reader.step()
    assert (reader.status.frames, reader.status.reconnects) == (2, 0)


def test_a_driver_that_does_not_return_is_a_fault_and_keeps_no_station_from_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The reader is inside it, so the consumer says so; with the next frame it is over."""
    clock, is_inside, may_return = ManualClock(), threading.Event(), threading.Event()
    device = ScriptedDevice(clock, b"1", b"2", b"3")
    read = device.read

    def hang(deadline_ns: int) -> CameraFrame:
        is_inside.set()
        may_return.wait()
        return read(clock.monotonic_ns() + 1)

    reader = Reader(clock, [device])
    reader.step(), reader.step()
    assert reader.next(0) is not None
    monkeypatch.setattr(device, "read", hang)
    monkeypatch.setattr("edge.acquisition.STUCK_S", 0.1)
    reader.start()
    is_inside.wait()
    assert reader.next(0) is None
    assert reader.status.state is STREAMING
    clock.sleep(0.2)
    assert reader.next(0) is None
    assert reader.said[-1] == (
        FAULT,
        "the sensor's driver does not return; unplug the sensor and plug it in again",
    )
    reader.close()
    assert device.closed == 0
    may_return.set()
    wait_until(lambda: reader.said[-1][0] is STREAMING)


def test_a_sensor_that_is_silent_is_opened_again_after_the_stall_time() -> None:
    """Short waits until the two seconds are over by the clock, then a fault."""
    clock = ManualClock()
    reader = Reader(clock, [ScriptedDevice(clock, *[DeviceStalled("nothing yet")] * 2)])
    assert (reader.step(), reader.step(), reader.status.state) == (0, 0, AcquisitionState.CONNECTING)
    clock.sleep(2.0)
    assert reader.step() > 0
    assert reader.status.state is FAULT


def test_a_sensor_that_is_opened_again_and_repeats_its_last_frame_stays_a_fault() -> None:
    """A camera that hangs still has its last frame: opening it again makes it no new one. Then it works again."""
    clock = ManualClock()
    hung = [ScriptedDevice(clock, jpeg(0), *[DeviceStalled("no new frame")] * 2) for _ in range(4)]
    reader = Reader(clock, [*hung, ScriptedDevice(clock, jpeg(0), jpeg(1), OVER)])
    while reader.status.frames < 2:
        reader.step()
        clock.sleep(1.5)
    assert [state for state, _ in reader.said] == [STREAMING, FAULT, STREAMING]
    assert [frame.payload for frame in reader.waiting()] == [jpeg(1)], "the first one became too old"


def test_pulled_out_again_and_again_while_a_thread_reads(tmp_path: Path) -> None:
    """Ten times unplugged and plugged in: ten reconnections, every frame once, in order."""
    options, clock = options_for(tmp_path, frames=100), SystemClock()
    bench, seen = plugin.bench(options, clock), list[bytes]()
    backoff = Backoff(random.Random(1), first_s=0.001, ceiling_s=0.004)

    def take_until(state: AcquisitionState) -> None:
        """Take waiting frames, so that a reader on demand goes on."""

        def is_reached() -> bool:
            frame = acquisition.next(0)
            seen.extend([frame.payload] if frame else [])
            return acquisition.status.state is state

        wait_until(is_reached)

    with Acquisition(lambda: plugin.open(options, clock), clock, depth=4, backoff=backoff) as acquisition:
        for pull in range(1, 11):
            take_until(STREAMING)
            bench.sensor.unplug()
            take_until(FAULT)
            bench.bus.plug_in(bench.sensor, port=1 + pull % 4)
        take_until(STREAMING)
        seen += all_frames(acquisition)
        status = acquisition.status
    assert (status.reconnects, status.frames) == (10, len(seen))
    order = [jpeg(seed) for seed in range(100)]
    places = [order.index(payload) for payload in seen]
    assert places == sorted(set(places))


def test_who_gets_the_end_finds_its_state() -> None:
    """The state is ENDED before `next` raises: a consumer that looks at it then is not a moment too early."""
    clock, taken = ManualClock(), list[CameraFrame | None]()

    def note(status: AcquisitionStatus) -> None:
        if status.state is ENDED:
            taken.append(acquisition.next(0))  # raises when the end has come already

    acquisition = Acquisition(lambda: ScriptedDevice(clock, OVER), clock, note)
    with acquisition, pytest.raises(RecordingEnded):
        acquisition.next(PATIENCE_S)
    assert taken == [None]


def test_what_is_no_device_fault_reaches_the_consumer(tmp_path: Path) -> None:
    """A recording that does not exist is not retried: `next` raises the error. A sensor that is away is no error."""
    clock, options = ManualClock(), UsbMockOptions(recording=tmp_path / "nowhere")
    with (
        Acquisition(lambda: plugin.open(options, clock), clock) as acquisition,
        pytest.raises(RecordingError),
    ):
        acquisition.next(PATIENCE_S)
    reader = Reader(clock, [DeviceNotFound("nothing")])
    reader.step()
    assert reader.next(0) is None


def test_a_reader_that_waits_for_the_consumer(tmp_path: Path) -> None:
    """Ten seconds of an inspection while the queue is full are not the sensor's silence, and `close` does not hang."""
    options, clock = options_for(tmp_path, frames=20), ManualClock()
    with Acquisition(lambda: plugin.open(options, clock), clock, depth=2) as acquisition:
        wait_until(lambda: acquisition.status.frames == 2)
        clock.sleep(10)
        for _ in range(5):
            assert acquisition.next(PATIENCE_S) is not None
        wait_until(lambda: acquisition.status.frames == 7)
        assert acquisition.status.reconnects == 0
        acquisition.close()
        acquisition.close()
        assert "acquisition" not in [thread.name for thread in threading.enumerate()]
        assert acquisition.status.state is CLOSED
