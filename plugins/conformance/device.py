"""What every device must do. The author supplies a bench that plays given frames and can unplug the device."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Final, Protocol

from edge.core.errors import DeviceLost, DeviceStalled, FrameCorrupt, RecordingEnded
from edge.core.ports import Clock, CountsStale, Device
from plugins.conformance.running import collect, raises, require, require_order, run_all

__all__ = ["DEVICE_CHECKS", "PERIOD_S", "SIZE", "DeviceBench", "check_device", "picture"]

SIZE: Final = (64, 48)
"""(width, height) of the frames that a bench is given."""

PERIOD_S: Final = 0.05
"""From one frame to the next, if a bench plays in real time."""


class DeviceBench(Protocol):
    """One device under test."""

    @property
    def clock(self) -> Clock:
        """The clock that the device was opened with."""

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        """The device, ready to deliver these JPEG frames: each on request, or one per PERIOD_S."""

    def unplug(self) -> None:
        """Remove the source of the device, as a pulled cable does."""


@cache
def picture(seed: int) -> bytes:
    """A JPEG of noise in SIZE; each seed gives different bytes."""
    import cv2
    import numpy as np

    noise = np.random.default_rng(seed).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    return cv2.imencode(".jpg", noise)[1].tobytes()


def check_device(make_bench: Callable[[], DeviceBench]) -> None:
    """Run every check, each on a new bench. Errors: ExceptionGroup."""
    run_all("device", DEVICE_CHECKS, make_bench)


def check_it_knows_who_it_is(bench: DeviceBench) -> None:
    """Product, serial and mode are known before the first frame."""
    device = bench.open([picture(0)])
    require(isinstance(device, Device), f"{type(device).__name__} lacks a part of Device")
    require(bool(device.identity.product and device.identity.serial), f"it is {device.identity}")
    require(device.identity.mode == SIZE, f"its mode is {device.identity.mode}, the frames are {SIZE}")
    device.close()


def check_frames_are_untouched(bench: DeviceBench) -> None:
    """Payloads arrive unchanged and in order; sequence numbers rise, times do not decrease."""
    sent = [picture(seed) for seed in range(5)]
    device = bench.open(sent)
    frames = [device.read(_soon(bench)) for _ in sent]
    device.close()
    require([frame.payload for frame in frames] == sent, "payloads differ from those played")
    require_order(frames)


def check_a_frame_has_its_time(bench: DeviceBench) -> None:
    """By the bench's clock, unless it is made on demand: requests and frames are taken in the order of their times."""
    before_ns, device = bench.clock.monotonic_ns(), bench.open([picture(0)], real_time=True)
    frame = device.read(_soon(bench))
    device.close()
    is_so = frame.is_on_demand or before_ns <= frame.timestamp_ns <= bench.clock.monotonic_ns()
    require(is_so, f"a frame has the time {frame.timestamp_ns}, and was read after {before_ns}")


def check_the_deadline_is_kept(bench: DeviceBench) -> None:
    """No frame by the deadline is DeviceStalled, not earlier; no frame is lost by it."""
    device = bench.open([picture(0), picture(1)], real_time=True)
    device.read(_soon(bench))
    deadline = bench.clock.monotonic_ns() + round(PERIOD_S * 1e9 / 2)
    raises(DeviceStalled, "no frame before the deadline", lambda: device.read(deadline))
    require(bench.clock.monotonic_ns() >= deadline, "it gave up before the deadline")
    require(device.read(_soon(bench)).payload == picture(1), "the next frame is not the next one played")
    device.close()


def check_a_frame_comes_once(bench: DeviceBench) -> None:
    """A repeated frame is left out, and counted if the device counts."""
    device = bench.open([picture(0), picture(0), picture(0), picture(1)])
    payloads = [device.read(_soon(bench)).payload for _ in range(2)]
    require(payloads == [picture(0), picture(1)], "a frame was delivered twice")
    if isinstance(device, CountsStale):
        require(device.stale == 2, f"it counts {device.stale} repeated frames, expected 2")
    device.close()


def check_a_damaged_frame(bench: DeviceBench) -> None:
    """A truncated JPEG is FrameCorrupt, and the next frame is good."""
    device = bench.open([picture(0), picture(1)[:-40], picture(2)])
    device.read(_soon(bench))
    raises(FrameCorrupt, "half a JPEG", lambda: device.read(_soon(bench)))
    require(device.read(_soon(bench)).payload == picture(2), "the frame after the damaged one is missing")
    device.close()


def check_unplugged(bench: DeviceBench) -> None:
    """Every read without the source is DeviceLost; closing is then harmless."""
    device = bench.open([picture(seed) for seed in range(5)])
    device.read(_soon(bench))
    bench.unplug()
    for _ in range(3):
        raises(DeviceLost, "read of an unplugged device", lambda: device.read(_soon(bench)))
    device.close()


def check_closed_twice(bench: DeviceBench) -> None:
    """Closing twice is harmless, and a closed device does not read."""
    device = bench.open([picture(0), picture(1)])
    device.read(_soon(bench))
    device.close()
    device.close()
    raises(DeviceLost, "read of a closed device", lambda: device.read(_soon(bench)))


def check_after_the_last_frame(bench: DeviceBench) -> None:
    """No frame is delivered again after the last one: every read is RecordingEnded or DeviceStalled."""
    device = bench.open([picture(0)])
    device.read(_soon(bench))
    for _ in range(2):
        try:
            frame = device.read(_soon(bench))
        except (RecordingEnded, DeviceStalled):
            continue
        raise AssertionError(f"after the last frame it delivered frame {frame.sequence}")
    device.close()


DEVICE_CHECKS: Final[tuple[Callable[[DeviceBench], None], ...]] = collect(globals(), DeviceBench)


def _soon(bench: DeviceBench) -> int:
    """A deadline that an available frame does not miss."""
    return bench.clock.monotonic_ns() + round(20 * PERIOD_S * 1e9)
