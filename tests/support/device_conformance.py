"""What every `Device` must do. A plugin's test makes a bench that can play given payloads and pull the plug."""

from collections.abc import Callable, Sequence
from typing import Protocol

import pytest
from small_recordings import PERIOD_NS, jpeg

from edge.core.errors import DeviceLost, DeviceStalled, FrameCorrupt, RecordingEnded
from edge.core.ports import Clock, Device

SECOND = 1_000_000_000


class Bench(Protocol):
    """One device under test, playing `payloads` of 64x48, in real time or as fast as it is read."""

    @property
    def clock(self) -> Clock: ...
    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device: ...
    def unplug(self) -> None: ...


def read(bench: Bench, device: Device, within_ns: int = 10 * SECOND) -> bytes:
    return device.read(bench.clock.monotonic_ns() + within_ns).payload


def check_identity(bench: Bench) -> None:
    """It is a Device and knows who it is before the first frame."""
    device = bench.open([jpeg(0)])
    assert isinstance(device, Device)
    assert device.identity.serial == "2BNN4ZE7"
    assert device.identity.mode == (64, 48)
    device.close()


def check_frames_are_untouched(bench: Bench) -> None:
    """Payloads come as they were recorded, in order, with rising sequence numbers and times that never go back."""
    sent = [jpeg(seed) for seed in range(5)]
    device = bench.open(sent)
    frames = [device.read(bench.clock.monotonic_ns() + SECOND) for _ in sent]
    device.close()
    assert [frame.payload for frame in frames] == sent
    assert [frame.sequence for frame in frames] == [0, 1, 2, 3, 4]
    times = [frame.timestamp_ns for frame in frames]
    assert times == sorted(times)


def check_stalled_at_the_deadline(bench: Bench) -> None:
    """No frame by the deadline is DeviceStalled, not earlier; the frame is not lost by it."""
    device = bench.open([jpeg(0), jpeg(1)], real_time=True)
    read(bench, device)
    deadline = bench.clock.monotonic_ns() + PERIOD_NS // 2
    with pytest.raises(DeviceStalled):
        device.read(deadline)
    assert bench.clock.monotonic_ns() >= deadline
    assert read(bench, device) == jpeg(1)
    device.close()


def check_stale_is_never_delivered(bench: Bench) -> None:
    """A frame that comes again is left out and counted; the next new one is delivered."""
    device = bench.open([jpeg(0), jpeg(0), jpeg(0), jpeg(1)])
    assert [read(bench, device), read(bench, device)] == [jpeg(0), jpeg(1)]
    assert getattr(device, "stale") == 2  # noqa: B009 - optional part of the port
    device.close()


def check_one_corrupt_frame(bench: Bench) -> None:
    """A broken frame is FrameCorrupt, and the next one is good."""
    device = bench.open([jpeg(0), jpeg(1)[:-40], jpeg(2)])
    assert read(bench, device) == jpeg(0)
    with pytest.raises(FrameCorrupt, match="FFD9"):
        read(bench, device)
    assert read(bench, device) == jpeg(2)
    device.close()


def check_unplugged(bench: Bench) -> None:
    """Without its source it is DeviceLost, again and again; closing it then is harmless."""
    device = bench.open([jpeg(seed) for seed in range(5)])
    read(bench, device)
    bench.unplug()
    for _ in range(3):
        with pytest.raises(DeviceLost):
            read(bench, device)
    device.close()


def check_closed_twice(bench: Bench) -> None:
    """Closing twice is harmless, and a closed device does not read."""
    device = bench.open([jpeg(0), jpeg(1)])
    read(bench, device)
    device.close()
    device.close()
    with pytest.raises(DeviceLost):
        read(bench, device)


def check_end_of_recording(bench: Bench) -> None:
    """After the last frame it is RecordingEnded, as often as one asks."""
    device = bench.open([jpeg(0)])
    read(bench, device)
    for _ in range(2):
        with pytest.raises(RecordingEnded):
            read(bench, device)
    device.close()


CHECKS: tuple[Callable[[Bench], None], ...] = (
    check_identity,
    check_frames_are_untouched,
    check_stalled_at_the_deadline,
    check_stale_is_never_delivered,
    check_one_corrupt_frame,
    check_unplugged,
    check_closed_twice,
    check_end_of_recording,
)
