"""The reader thread: its counters, its messages, and its reconnection."""

import random
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from small_recordings import SERIAL, jpeg, write_recording

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

PATIENCE_S = 60.0


def quick() -> Backoff:
    return Backoff(random.Random(1), first_s=0.001, ceiling_s=0.004)


def options_for(tmp_path: Path, *faults: str, frames: int = 8, **more: object) -> UsbMockOptions:
    recording = write_recording(tmp_path / "recording", frames)
    return UsbMockOptions.model_validate({"recording": recording, "pace": 0.0, "faults": faults, **more})


def all_frames(acquisition: Acquisition) -> list[CameraFrame]:
    frames = []
    while True:
        try:
            frame = acquisition.next(PATIENCE_S)
        except RecordingEnded:
            return frames
        assert frame is not None
        frames.append(frame)


def wait_for(fact: Callable[[], bool]) -> None:
    """Wait until another thread has done its part; the limit only ends a failing test."""
    end = time.monotonic() + PATIENCE_S
    while not fact():
        assert time.monotonic() < end, "the other thread never came there"
        time.sleep(0.001)


def take_until(state: AcquisitionState, acquisition: Acquisition, seen: list[bytes]) -> None:
    """Take waiting frames, so that a reader at pace 0 continues, until the state is reached."""

    def reached() -> bool:
        frame = acquisition.next(0)
        if frame is not None:
            seen.append(frame.payload)
        return acquisition.status.state is state

    wait_for(reached)


class ScriptedDevice:
    """Reads from a list: a payload, or an error to raise."""

    def __init__(self, script: list[bytes | Exception], clock: ManualClock) -> None:
        self.identity = DeviceIdentity("GelSight Mini R0B 2BNN-4ZE7", SERIAL, (64, 48), 25.0)
        self.closed = 0
        self._script, self._clock = script, clock

    def read(self, deadline_ns: int) -> CameraFrame:
        step = self._script.pop(0)
        if isinstance(step, Exception):
            raise step
        self._clock.sleep(0.05)
        return CameraFrame(step, self._clock.monotonic_ns(), 0)

    def close(self) -> None:
        self.closed += 1


def test_every_frame_of_a_recording_as_fast_as_read(tmp_path: Path) -> None:
    """At pace 0 nothing is dropped, however slow the consumer: the reader waits for it."""
    options = options_for(tmp_path, frames=40)
    clock = ManualClock()
    with Acquisition(lambda: plugin.open(options, clock), clock, depth=3) as acquisition:
        frames = all_frames(acquisition)
        status = acquisition.status
    assert [frame.payload for frame in frames] == [jpeg(seed) for seed in range(40)]
    assert (status.frames, status.dropped, status.state) == (40, 0, AcquisitionState.ENDED)


def test_a_lagging_consumer_gets_the_newest(tmp_path: Path) -> None:
    """Four frames are kept; the fifth makes the queue the newest alone, so the consumer is not left four behind."""
    clock = ManualClock()
    device = ScriptedDevice([*(jpeg(seed) for seed in range(10)), RecordingEnded("over")], clock)
    with Acquisition(lambda: device, clock, depth=4) as acquisition:
        wait_for(lambda: acquisition.status.state is AcquisitionState.ENDED)
        frames = all_frames(acquisition)
    assert [frame.payload for frame in frames] == [jpeg(seed) for seed in (8, 9)]
    assert [frame.sequence for frame in frames] == [9, 10]
    assert acquisition.status.dropped == 8


def test_a_backlog_never_grows_older_than_a_verdict_allows(tmp_path: Path) -> None:
    """24 frames of 50 ms and no consumer: the kept frames end with the newest and span at most 0.8 s."""
    clock = ManualClock()
    device = ScriptedDevice([*(jpeg(seed) for seed in range(24)), RecordingEnded("over")], clock)
    with Acquisition(lambda: device, clock) as acquisition:
        wait_for(lambda: acquisition.status.state is AcquisitionState.ENDED)
        frames = all_frames(acquisition)
    assert frames[-1].payload == jpeg(23)
    assert frames[-1].timestamp_ns - frames[0].timestamp_ns <= 800_000_000
    assert acquisition.status.dropped + len(frames) == acquisition.status.frames == 24


def test_who_gets_the_end_finds_its_state() -> None:
    """The state is ENDED before `next` raises: a consumer that looks at it then is not a moment too early."""
    clock = ManualClock()
    taken: list[CameraFrame | None] = []

    def note(status: AcquisitionStatus) -> None:
        if status.state is AcquisitionState.ENDED:
            taken.append(acquisition.next(0))  # raises when the end has come already

    acquisition = Acquisition(lambda: ScriptedDevice([RecordingEnded("over")], clock), clock, note)
    with acquisition, pytest.raises(RecordingEnded):
        acquisition.next(PATIENCE_S)
    assert taken == [None]


def test_faults_are_counted(tmp_path: Path) -> None:
    """Corrupt and stale frames are counted and never delivered; the rest arrives in order."""
    options = options_for(tmp_path, "error_bit@1", "truncate@3", "stale@5")
    clock = ManualClock()
    with Acquisition(lambda: plugin.open(options, clock), clock) as acquisition:
        frames = all_frames(acquisition)
        status = acquisition.status
    assert [frame.payload for frame in frames] == [jpeg(seed) for seed in (0, 2, 4, 6, 7)]
    assert (status.frames, status.corrupt, status.stale, status.reconnects) == (5, 2, 1, 0)


def test_pulled_twenty_times(tmp_path: Path) -> None:
    """Twenty times unplugged and re-plugged: twenty reconnections, every frame once, none twice."""
    options = options_for(tmp_path, frames=200, with_webcam=False)
    clock = SystemClock()
    bench = plugin.bench(options, clock)
    seen: list[bytes] = []
    with Acquisition(lambda: plugin.open(options, clock), clock, depth=4, backoff=quick()) as acquisition:
        for pull in range(1, 21):
            frame = acquisition.next(PATIENCE_S)
            assert frame is not None
            seen.append(frame.payload)
            bench.unplug()
            take_until(AcquisitionState.FAULT, acquisition, seen)
            bench.plug_in(port=1 + pull % 4)
            take_until(AcquisitionState.STREAMING, acquisition, seen)
        seen += [frame.payload for frame in all_frames(acquisition)]
        status = acquisition.status
    assert status.reconnects == 20
    assert len(seen) == len(set(seen))
    assert status.frames == len(seen)
    order = {jpeg(seed): seed for seed in range(200)}
    assert [order[payload] for payload in seen] == sorted(order[payload] for payload in seen)


def test_stall_opens_the_sensor_again(tmp_path: Path) -> None:
    """A stream that stops is closed and opened again, which ends this stall; no frame is lost."""
    options = options_for(tmp_path, "stall@3")
    clock = ManualClock()
    with Acquisition(
        lambda: plugin.open(options, clock), clock, stall_after_s=2, backoff=quick()
    ) as acquisition:
        frames = all_frames(acquisition)
        assert acquisition.status.reconnects == 1
    assert [frame.payload for frame in frames] == [jpeg(seed) for seed in range(8)]


def test_changes_are_published_once() -> None:
    """State and fault are published when they change, and only then."""
    clock = ManualClock()
    said: list[tuple[AcquisitionState, str | None]] = []
    openings: list[Device | Exception] = [
        DeviceNotFound("nothing"),
        DeviceNotFound("nothing"),
        ScriptedDevice([jpeg(0), jpeg(1), DeviceLost("pulled")], clock),
        ScriptedDevice([jpeg(2), RecordingEnded("over")], clock),
    ]

    def open_next() -> Device:
        step = openings.pop(0)
        if isinstance(step, Exception):
            raise step
        return step

    def note(status: AcquisitionStatus) -> None:
        said.append((status.state, status.fault))

    with Acquisition(open_next, clock, note, backoff=quick()) as acquisition:
        assert len(all_frames(acquisition)) == 3
        wait_for(lambda: acquisition.status.state is AcquisitionState.ENDED)
    assert said == [
        (AcquisitionState.FAULT, "nothing"),
        (AcquisitionState.STREAMING, None),
        (AcquisitionState.FAULT, "pulled"),
        (AcquisitionState.STREAMING, None),
        (AcquisitionState.ENDED, None),
        (AcquisitionState.CLOSED, None),
    ]


def test_a_reconnection_leaves_a_gap() -> None:
    """Frames before and after a loss are not consecutive, so they are not taken for one movement."""
    clock = ManualClock()
    devices = [
        ScriptedDevice([jpeg(0), jpeg(1), DeviceLost("pulled")], clock),
        ScriptedDevice([jpeg(2), RecordingEnded("over")], clock),
    ]
    with Acquisition(lambda: devices.pop(0), clock, backoff=quick()) as acquisition:
        assert [frame.sequence for frame in all_frames(acquisition)] == [1, 2, 4]


def test_pauses_grow_with_failures_in_a_row_and_frames_end_the_row() -> None:
    """The pauses are the shared `Backoff`: three failures make the row three long, a frame starts a new row."""
    clock, backoff = ManualClock(), quick()
    rows: list[int] = []
    openings: list[Device | Exception] = [
        DeviceNotFound("none"),
        DeviceNotFound("none"),
        ScriptedDevice([jpeg(0), DeviceLost("pulled")], clock),
        ScriptedDevice([RecordingEnded("over")], clock),
    ]

    def open_next() -> Device:
        rows.append(backoff.failures)
        step = openings.pop(0)
        if isinstance(step, Exception):
            raise step
        return step

    with Acquisition(open_next, clock, backoff=backoff) as acquisition:
        all_frames(acquisition)
    assert rows == [0, 1, 2, 1]


def test_another_sensor_is_not_taken_for_the_first() -> None:
    """Another sensor plugged in while running: refused with both serials and closed, so wear is not counted on its
    gel."""
    clock = ManualClock()
    other = ScriptedDevice([jpeg(1)], clock)
    other.identity = DeviceIdentity("GelSight Mini R0B 28D8-PXEC", "28D8PXEC", (64, 48), 25.0)
    first = ScriptedDevice([jpeg(0), DeviceLost("pulled")], clock)
    again = ScriptedDevice([jpeg(2), RecordingEnded("over")], clock)
    devices: list[Device] = [first, other, again]
    said: list[str | None] = []
    with Acquisition(
        lambda: devices.pop(0), clock, lambda now: said.append(now.fault), backoff=quick()
    ) as acquisition:
        assert [frame.payload for frame in all_frames(acquisition)] == [jpeg(0), jpeg(2)]
        assert acquisition.status.reconnects == 1
    assert other.closed == 1
    assert any(fault and SERIAL in fault and "28D8PXEC" in fault for fault in said)


def test_every_device_is_closed_once() -> None:
    """A device is closed in every case that ends its use."""
    clock = ManualClock()
    devices = [
        ScriptedDevice([DeviceLost("pulled")], clock),
        ScriptedDevice([jpeg(0), RecordingEnded("over")], clock),
    ]
    waiting = list(devices)
    with Acquisition(lambda: waiting.pop(0), clock, backoff=quick()) as acquisition:
        all_frames(acquisition)
    assert [device.closed for device in devices] == [1, 1]


def test_what_is_no_device_fault_reaches_the_consumer(tmp_path: Path) -> None:
    """A recording that does not exist is not retried: `next` raises the error."""
    clock = ManualClock()
    options = UsbMockOptions(recording=tmp_path / "nowhere")
    with (
        Acquisition(lambda: plugin.open(options, clock), clock) as acquisition,
        pytest.raises(RecordingError),
    ):
        acquisition.next(PATIENCE_S)


def test_rate_is_measured() -> None:
    """Frames 50 ms apart are 20 fps."""
    clock = ManualClock()
    device = ScriptedDevice([*(jpeg(seed) for seed in range(10)), RecordingEnded("over")], clock)
    with Acquisition(lambda: device, clock) as acquisition:
        all_frames(acquisition)
    assert acquisition.status.fps == pytest.approx(20.0)


def test_nothing_yet_is_none(tmp_path: Path) -> None:
    """No frame in time is None, not an error."""
    clock = ManualClock()

    def never() -> Device:
        raise DeviceNotFound("nothing")

    with Acquisition(never, clock, backoff=quick()) as acquisition:
        assert acquisition.next(0.001) is None


def test_close_ends_the_thread_while_the_reader_waits_for_room(tmp_path: Path) -> None:
    """Closing does not hang on a full queue, and closing twice is harmless."""
    options = options_for(tmp_path, frames=20)
    clock = ManualClock()
    acquisition = Acquisition(lambda: plugin.open(options, clock), clock, depth=2)
    acquisition.start()
    wait_for(lambda: acquisition.status.frames == 2)
    acquisition.close()
    acquisition.close()
    assert "acquisition" not in [thread.name for thread in threading.enumerate()]
    assert acquisition.status.state is AcquisitionState.CLOSED


def test_a_wait_for_the_consumer_is_not_the_sensors_silence(tmp_path: Path) -> None:
    """An inspection of ten seconds, while the queue is full: the sensor is not opened again."""
    options = options_for(tmp_path, frames=20)
    clock = ManualClock()
    with Acquisition(lambda: plugin.open(options, clock), clock, depth=2) as acquisition:
        wait_for(lambda: acquisition.status.frames == 2)
        clock.sleep(10)
        frames = all_frames(acquisition)

    assert len(frames) == 20
    assert acquisition.status.reconnects == 0


def test_the_reader_steps_without_a_thread_and_without_time() -> None:
    """Open, a frame, a broken one, unplugged, a pause, opened again, a frame: in the order in which steps are taken."""
    clock = ManualClock()
    devices = [
        ScriptedDevice(
            [jpeg(0), FrameCorrupt("half a frame"), DeviceLost("the sensor was unplugged")], clock
        ),
        ScriptedDevice([jpeg(1), RecordingEnded("over")], clock),
    ]
    waiting = list(devices)
    acquisition = Acquisition(lambda: waiting.pop(0), clock, backoff=Backoff(random.Random(0), 0.5, 10.0))
    pauses, states = [], []
    for _ in range(6):
        pauses.append(acquisition.step())
        states.append(acquisition.status.state)
    with pytest.raises(RecordingEnded):
        acquisition.step()
    taken = [acquisition.next(0), acquisition.next(0), acquisition.next(0)]
    acquisition.close()

    assert [pause > 0 for pause in pauses] == [False, False, False, True, False, False]
    assert states[3] is AcquisitionState.FAULT
    assert states[0] is AcquisitionState.CONNECTING
    assert states[4] is AcquisitionState.FAULT, "it is open, and has not given a frame"
    assert states[2] is states[5] is AcquisitionState.STREAMING
    assert [frame.payload if frame else None for frame in taken] == [jpeg(0), jpeg(1), None]
    assert (acquisition.status.corrupt, acquisition.status.reconnects) == (1, 1)
    assert [device.closed for device in devices] == [1, 1]


def test_a_pause_of_the_computer_is_not_the_sensors_silence() -> None:
    """Suspended for three seconds, or as busy: the frames that wait are read, and the sensor is not opened again."""
    clock = ManualClock()

    class Punctual(ScriptedDevice):
        def read(self, deadline_ns: int) -> CameraFrame:
            if deadline_ns <= clock.monotonic_ns():
                raise DeviceStalled("no time to look")
            return super().read(deadline_ns)

    acquisition = Acquisition(lambda: Punctual([jpeg(0), jpeg(1)], clock), clock)
    for _ in range(2):
        acquisition.step()
    clock.sleep(3.0)
    acquisition.step()
    acquisition.close()

    assert (acquisition.status.frames, acquisition.status.reconnects) == (2, 0)


def test_a_sensor_that_is_silent_is_opened_again_after_the_stall_time() -> None:
    """Short waits until the two seconds are over by the clock, then a fault; no thread sleeps for it."""
    clock = ManualClock()
    acquisition = Acquisition(lambda: ScriptedDevice([DeviceStalled("nothing yet")] * 2, clock), clock)
    assert acquisition.step() == 0.0
    assert acquisition.step() == 0.0
    assert acquisition.status.state is AcquisitionState.CONNECTING
    clock.sleep(2.0)
    assert acquisition.step() > 0
    assert acquisition.status.state is AcquisitionState.FAULT
    acquisition.close()


def test_a_sensor_that_is_opened_again_and_repeats_its_last_frame_stays_a_fault() -> None:
    """A camera that hangs still has its last frame: opening it again makes it no new one. Then it works again."""
    clock = ManualClock()
    silent: list[bytes | Exception] = [DeviceStalled("no new frame")]
    hung = [ScriptedDevice([jpeg(0), *silent * 2], clock) for _ in range(4)]
    waiting = [*hung, ScriptedDevice([jpeg(0), jpeg(1), RecordingEnded("over")], clock)]
    said: list[AcquisitionState] = []
    acquisition = Acquisition(lambda: waiting.pop(0), clock, lambda status: said.append(status.state))
    frames: list[CameraFrame] = []
    while acquisition.status.frames < 2:
        acquisition.step()
        frames += [frame] if (frame := acquisition.next(0)) else []
        clock.sleep(1.5)
    S, F = AcquisitionState.STREAMING, AcquisitionState.FAULT
    assert said == [S, F, S], "a fault from the first silence to the first new frame"
    assert [frame.payload for frame in frames] == [jpeg(0), jpeg(1)]
