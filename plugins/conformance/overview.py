"""What every overview camera does, beyond being a `Device`: complete pictures, in the size that it says."""

from collections.abc import Callable
from typing import Final, Protocol

from edge.core.errors import DeviceError
from edge.core.ports import Clock, Device
from plugins.conformance.running import collect, raises, require, require_order, run_all

__all__ = ["OVERVIEW_CHECKS", "OverviewBench", "check_overview"]

# A camera that has started gives a picture in this time.
PATIENCE_S: Final = 20.0


class OverviewBench(Protocol):
    """One overview camera under test."""

    @property
    def clock(self) -> Clock:
        """The clock that the camera was opened with."""

    def open(self) -> Device:
        """The camera, ready to give at least three pictures."""


def check_overview(make_bench: Callable[[], OverviewBench]) -> None:
    """Run every check, each on a new bench. Errors: ExceptionGroup."""
    run_all("overview", OVERVIEW_CHECKS, make_bench)


def check_it_knows_who_it_is(bench: OverviewBench) -> None:
    """Product and serial are known before the first picture."""
    device = bench.open()
    require(isinstance(device, Device), f"{type(device).__name__} lacks a part of Device")
    require(bool(device.identity.product and device.identity.serial), f"it is {device.identity}")
    device.close()


def check_pictures_are_complete(bench: OverviewBench) -> None:
    """Each is one complete JPEG or PNG, of the size in the identity."""
    device = bench.open()
    frames = [device.read(_later(bench)) for _ in range(3)]
    device.close()
    require(all(frame.damage is None for frame in frames), f"damaged: {[frame.damage for frame in frames]}")
    sizes = {frame.size for frame in frames}
    require(sizes == {device.identity.mode}, f"it says {device.identity.mode}, the pictures are {sizes}")


def check_pictures_come_in_order(bench: OverviewBench) -> None:
    """Sequence numbers rise, times do not decrease."""
    device = bench.open()
    frames = [device.read(_later(bench)) for _ in range(3)]
    device.close()
    require_order(frames)


def check_closed_twice(bench: OverviewBench) -> None:
    """Closing twice is harmless, and a closed camera gives no picture."""
    device = bench.open()
    device.read(_later(bench))
    device.close()
    device.close()
    raises(DeviceError, "read of a closed camera", lambda: device.read(_later(bench)))


OVERVIEW_CHECKS: Final[tuple[Callable[[OverviewBench], None], ...]] = collect(globals(), OverviewBench)


def _later(bench: OverviewBench) -> int:
    return bench.clock.monotonic_ns() + round(PATIENCE_S * 1e9)
