"""What every pedal or button must do. The author supplies a bench that presses it and can unplug it."""

import contextlib
from collections.abc import Callable
from typing import Final, Protocol

from edge.core.digital_io import Trigger
from edge.core.errors import DeviceLost, DeviceNotFound
from edge.core.ports import Clock
from plugins.conformance.running import collect, raises, require, run_all

__all__ = ["TRIGGER_CHECKS", "TriggerBench", "check_trigger"]

_WAIT_NS: Final = 500_000_000


class TriggerBench(Protocol):
    """One pedal or button under test."""

    @property
    def clock(self) -> Clock:
        """The clock that the trigger was opened with."""

    def open(self) -> Trigger:
        """The trigger, released, opened by its plugin."""

    def press(self) -> None:
        """Push it down; the next read sees it."""

    def release(self) -> None:
        """Let it go; the next read sees it."""

    def unplug(self) -> None:
        """Remove it, as a pulled cable does."""


def check_trigger(make_bench: Callable[[], TriggerBench]) -> None:
    """Run every check, each on a new bench. Errors: ExceptionGroup."""
    run_all("trigger", TRIGGER_CHECKS, make_bench)


def check_it_has_a_name(bench: TriggerBench) -> None:
    """A person can tell which one it is, and it is present."""
    trigger = bench.open()
    require(isinstance(trigger, Trigger), f"{type(trigger).__name__} lacks a part of Trigger")
    require(bool(trigger.name), "it has no name")
    require(trigger.is_present(), "it is plugged in, and says that it is not present")
    trigger.close()


def check_each_change_comes_once(bench: TriggerBench) -> None:
    """Down, then up, then nothing until the deadline."""
    trigger = bench.open()
    bench.press()
    require(trigger.read(_soon(bench)) is True, "a press is not seen")
    require(trigger.read(_soon(bench)) is None, "a press that lasts is seen twice")
    bench.release()
    require(trigger.read(_soon(bench)) is False, "the release is not seen")
    require(trigger.read(_soon(bench)) is None, "a release is seen twice")
    trigger.close()


def check_the_deadline_is_kept(bench: TriggerBench) -> None:
    """`read` returns at its deadline, not earlier, when nothing changes."""
    trigger, deadline_ns = bench.open(), _soon(bench)
    require(trigger.read(deadline_ns) is None, "a change is seen, and there was none")
    require(bench.clock.monotonic_ns() >= deadline_ns, "it gave up before the deadline")
    trigger.close()


def check_unplugged(bench: TriggerBench) -> None:
    """An unplugged trigger is not present, and no read sees a press: each is silent or DeviceLost.

    Opening is DeviceNotFound or DeviceLost.
    """
    trigger = bench.open()
    bench.unplug()
    require(not trigger.is_present(), "it is unplugged, and says that it is present")
    with contextlib.suppress(DeviceLost):
        require(trigger.read(_soon(bench)) is None, "an unplugged pedal is pressed")
    trigger.close()
    raises((DeviceNotFound, DeviceLost), "opening an unplugged one", bench.open)


def check_closed_twice(bench: TriggerBench) -> None:
    """Closing twice is harmless, and a closed one does not read."""
    trigger = bench.open()
    trigger.close()
    trigger.close()
    raises(DeviceLost, "read of a closed one", lambda: trigger.read(_soon(bench)))


TRIGGER_CHECKS: Final[tuple[Callable[[TriggerBench], None], ...]] = collect(globals(), TriggerBench)


def _soon(bench: TriggerBench) -> int:
    return bench.clock.monotonic_ns() + _WAIT_NS
