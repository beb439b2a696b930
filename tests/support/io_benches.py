"""Benches of the built-in pedals and relay boards, for the checks of `plugins.conformance`."""

from fake_gpio import FALLING, RISING, FakeKernel

from edge.clock import ManualClock
from edge.core.digital_io import Actuator, Trigger
from plugins.digital_io import virtual_hid
from plugins.digital_io.gpio import ButtonOptions, GpioButton, GpioRelays, RelaysOptions
from plugins.digital_io.virtual_hid import VirtualHidBus, VirtualHidOptions, bus_of

__all__ = ["ACTUATORS", "TRIGGERS"]


class VirtualPedalBench:
    """The pedal's driver on the virtual bus. silent: an unplugged device gives no error, as on Linux."""

    def __init__(self, *, silent: bool = True) -> None:
        self.clock = ManualClock()
        self._options = VirtualHidOptions()
        self.bus: VirtualHidBus = bus_of(self._options, self.clock)
        self.bus.is_silent = silent

    def open(self) -> Trigger:
        return virtual_hid.trigger.open(self._options, self.clock)

    def press(self) -> None:
        self.bus.pedal_is_down = True

    def release(self) -> None:
        self.bus.pedal_is_down = False

    def unplug(self) -> None:
        self.bus.is_plugged_in = False


class VirtualRelayBench:
    """The board's driver on the virtual bus."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self._options = VirtualHidOptions()
        self.bus: VirtualHidBus = bus_of(self._options, self.clock)

    def open(self) -> Actuator:
        return virtual_hid.actuator.open(self._options, self.clock)

    def outputs(self) -> list[bool]:
        return list(self.bus.relays)

    def unplug(self) -> None:
        self.bus.is_plugged_in = False


class GpioButtonBench:
    """A button at a line of a chip that a test decides."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.kernel = FakeKernel(self.clock)

    def open(self) -> Trigger:
        return GpioButton(self.kernel, ButtonOptions(line=17), self.clock)

    def press(self) -> None:
        self.kernel.edges.append(RISING)

    def release(self) -> None:
        self.kernel.edges.append(FALLING)

    def unplug(self) -> None:
        self.kernel.is_plugged_in = False


class GpioRelaysBench:
    """Two relays at lines of that chip."""

    lines = (5, 6)

    def __init__(self) -> None:
        self.kernel = FakeKernel(ManualClock())

    def open(self) -> Actuator:
        return GpioRelays(self.kernel, RelaysOptions(lines=self.lines))

    def outputs(self) -> list[bool]:
        return [bool(self.kernel.levels.get(line)) for line in self.lines]

    def unplug(self) -> None:
        self.kernel.is_plugged_in = False


TRIGGERS = {
    "virtual_hid": VirtualPedalBench,
    "virtual_hid, with errors": lambda: VirtualPedalBench(silent=False),
    "gpio": GpioButtonBench,
}
ACTUATORS = {"virtual_hid": VirtualRelayBench, "gpio": GpioRelaysBench}
