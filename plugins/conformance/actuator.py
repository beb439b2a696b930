"""What every relay board or light must do. The author supplies a bench that sees its outputs and can unplug it."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, Protocol

from edge.core.digital_io import Actuator
from edge.core.errors import DeviceError, DeviceLost, DeviceNotFound
from plugins.conformance.running import collect, raises, require, run_all

__all__ = ["ACTUATOR_CHECKS", "ActuatorBench", "check_actuator"]


class ActuatorBench(Protocol):
    """One relay board or light under test."""

    def open(self) -> Actuator:
        """The actuator, opened by its plugin."""

    def outputs(self) -> Sequence[bool]:
        """The levels at its terminals, from channel 1 on."""

    def unplug(self) -> None:
        """Remove it, as a pulled cable does."""


def check_actuator(make_bench: Callable[[], ActuatorBench]) -> None:
    """Run every check, each on a new bench. Errors: ExceptionGroup."""
    run_all("actuator", ACTUATOR_CHECKS, make_bench)


def check_it_knows_its_channels(bench: ActuatorBench) -> None:
    """The actuator has a name and at least one channel, and is present."""
    actuator = bench.open()
    require(isinstance(actuator, Actuator), f"{type(actuator).__name__} lacks a part of Actuator")
    require(bool(actuator.name), "it has no name")
    require(actuator.channels == len(bench.outputs()), f"it says that it has {actuator.channels} channels")
    require(actuator.is_present(), "it is plugged in, and says that it is not present")
    actuator.close()


def check_each_channel_switches_alone(bench: ActuatorBench) -> None:
    """When `write` returns the output has its level, and no other one has changed."""
    actuator = bench.open()
    for channel in range(1, actuator.channels + 1):
        actuator.write(channel, False)
    expected = [False] * actuator.channels
    for is_on in (True, True, False):
        for channel in range(1, actuator.channels + 1):
            actuator.write(channel, is_on)
            expected[channel - 1] = is_on
            levels = list(bench.outputs())
            require(levels == expected, f"after channel {channel} {is_on}: {levels}, expected {expected}")
    actuator.close()


def check_opening_and_closing_switch_nothing(bench: ActuatorBench) -> None:
    """The driver decides what is safe, not the plugin."""
    actuator = bench.open()
    actuator.write(1, True)
    actuator.close()
    require(bench.outputs()[0], "closing has switched channel 1 off")
    bench.open().close()
    require(bench.outputs()[0], "opening has switched channel 1 off")


def check_a_channel_that_it_does_not_have(bench: ActuatorBench) -> None:
    """ValueError, and nothing is switched."""
    actuator = bench.open()
    before = list(bench.outputs())
    for channel in (0, -1, actuator.channels + 1):
        raises(ValueError, f"writing channel {channel}", partial(actuator.write, channel, True))
    require(list(bench.outputs()) == before, "a channel has changed")
    actuator.close()


def check_unplugged(bench: ActuatorBench) -> None:
    """Writing is a DeviceError, not a silence; it is not present, and cannot be opened."""
    actuator = bench.open()
    bench.unplug()
    raises(DeviceError, "writing to an unplugged one", lambda: actuator.write(1, True))
    require(not actuator.is_present(), "it is unplugged, and says that it is present")
    actuator.close()
    raises((DeviceNotFound, DeviceLost), "opening an unplugged one", bench.open)


def check_closed_twice(bench: ActuatorBench) -> None:
    """Closing twice is harmless, and a closed one does not switch."""
    actuator = bench.open()
    actuator.close()
    actuator.close()
    raises(DeviceLost, "writing to a closed one", lambda: actuator.write(1, True))


ACTUATOR_CHECKS: Final[tuple[Callable[[ActuatorBench], None], ...]] = collect(globals(), ActuatorBench)
