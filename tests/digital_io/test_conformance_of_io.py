"""Every built-in pedal and relay passes the published checks, and each check notices what it is about."""

from collections.abc import Callable
from typing import Any

import pytest
from fake_gpio import FALLING, RISING, FakeKernel

from edge.clock import ManualClock
from edge.core.digital_io import Actuator, Trigger
from edge.core.errors import GelgateError
from plugins.conformance import ACTUATOR_CHECKS, TRIGGER_CHECKS, check_actuator, check_trigger
from plugins.digital_io import virtual_hid
from plugins.digital_io.gpio import ButtonOptions, GpioButton, GpioRelays, RelaysOptions
from plugins.digital_io.virtual_hid import VirtualHidBus, VirtualHidOptions, bus_of


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


BUILT_IN: dict[str, tuple[Any, Callable[[], Any]]] = {
    "pedal": (TRIGGER_CHECKS, VirtualPedalBench),
    "pedal, with errors": (TRIGGER_CHECKS, lambda: VirtualPedalBench(silent=False)),
    "button": (TRIGGER_CHECKS, GpioButtonBench),
    "board": (ACTUATOR_CHECKS, VirtualRelayBench),
    "relays": (ACTUATOR_CHECKS, GpioRelaysBench),
}


@pytest.mark.parametrize(
    ("name", "check"), [(name, check) for name, (checks, _) in BUILT_IN.items() for check in checks]
)
def test_a_built_in_plugin_conforms(name: str, check: Callable[[Any], None]) -> None:
    check(BUILT_IN[name][1]())


class Wrong:
    """A device that is wrong in one way; the bench that opens it is otherwise the true one."""

    def __init__(self, bench: Any, **parts: Any) -> None:
        self._bench, self._parts = bench, parts

    def open(self) -> Any:
        return Changed(self._bench.open(), self._parts)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bench, name)


class Changed:
    def __init__(self, inner: Any, parts: dict[str, Any]) -> None:
        self._inner = inner
        vars(self).update({name: part(inner) if callable(part) else part for name, part in parts.items()})

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def writes_after_closing(inner: Any) -> Callable[..., None]:
    return lambda channel, is_on: None


TRIGGER_FAULTS: dict[str, dict[str, Any]] = {
    "check_it_has_a_name": {"name": ""},
    "check_each_change_comes_once": {"read": lambda inner: lambda deadline: True},
    "check_the_deadline_is_kept": {"read": lambda inner: lambda deadline: None},
    "check_unplugged": {"is_present": lambda inner: lambda: True},
    "check_closed_twice": {"close": lambda inner: lambda: None},
}
ACTUATOR_FAULTS: dict[str, dict[str, Any]] = {
    "check_it_knows_its_channels": {"channels": 9},
    "check_each_channel_switches_alone": {
        "write": lambda inner: lambda channel, is_on: inner.write(1, is_on)
    },
    "check_opening_and_closing_switch_nothing": {"close": lambda inner: lambda: inner.write(1, False)},
    "check_a_channel_that_it_does_not_have": {"write": writes_after_closing},
    "check_unplugged": {"write": writes_after_closing},
    "check_closed_twice": {"close": lambda inner: lambda: None},
}


@pytest.mark.parametrize(
    ("bench", "faults", "check"),
    [
        *((VirtualPedalBench, TRIGGER_FAULTS, check) for check in TRIGGER_CHECKS),
        *((VirtualRelayBench, ACTUATOR_FAULTS, check) for check in ACTUATOR_CHECKS),
    ],
)
def test_a_check_can_fail(
    bench: Callable[[], Any], faults: dict[str, Any], check: Callable[..., None]
) -> None:
    """A device that is wrong in that way."""
    with pytest.raises((AssertionError, GelgateError)):
        check(Wrong(bench(), **faults[check.__name__]))


def test_all_checks_run_in_one_call() -> None:
    check_trigger(VirtualPedalBench)
    check_actuator(VirtualRelayBench)
    with pytest.raises(ExceptionGroup, match="1 of 5 checks failed"):
        check_trigger(lambda: Wrong(VirtualPedalBench(), name=""))
