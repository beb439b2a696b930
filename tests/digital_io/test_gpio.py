"""GPIO lines, with the kernel's part replaced."""

import errno

import pytest
from fake_gpio import FALLING, RISING, FakeKernel
from pydantic import ValidationError

from edge.clock import ManualClock
from edge.core.digital_io import OutputRule, StationView
from edge.core.errors import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, DeviceStalled
from edge.features.outputs.actuator_driver import ActuatorDriver
from plugins.digital_io.gpio import ButtonOptions, GpioButton, GpioRelays, RelaysOptions


def test_a_line_that_drives_keeps_its_level_and_an_input_starts_off() -> None:
    """The driver decides what is safe; a floating input says nothing about a relay."""
    kernel = FakeKernel(ManualClock())
    kernel.levels = {5: True, 6: None}
    GpioRelays(kernel, RelaysOptions(lines=(5, 6)))

    assert kernel.levels == {5: True, 6: False}


def test_a_line_that_keeps_its_level_is_a_fault() -> None:
    kernel = FakeKernel(ManualClock())
    relays = GpioRelays(kernel, RelaysOptions(lines=(5, 6)))
    kernel.stuck = {6}
    relays.write(1, True)
    with pytest.raises(DeviceStalled, match=r"line 6 of /dev/gpiochip0 does not take its level"):
        relays.write(2, True)


def test_a_line_is_that_of_one_channel() -> None:
    """Else the light of a fail is the light of a pass."""
    with pytest.raises(ValidationError, match="line 5 is that of several channels; give each channel a line"):
        RelaysOptions(lines=(5, 6, 5))


def test_edges_that_come_together_are_read_one_by_one() -> None:
    """A short press between two reads is a press."""
    kernel = FakeKernel(ManualClock())
    button = GpioButton(kernel, ButtonOptions(line=17), kernel.clock)
    kernel.edges.extend([RISING, FALLING, FALLING, RISING])

    assert [button.read(0) for _ in range(4)] == [True, False, True, None]


@pytest.mark.parametrize(
    ("number", "kind", "words"),
    [
        (errno.ENOENT, DeviceNotFound, "there is no such chip; `gpiodetect`"),
        (errno.EACCES, DeviceBusy, "this user may not open the chip"),
        (errno.EBUSY, DeviceBusy, "another program or driver uses it"),
        (errno.ENODEV, DeviceLost, "cannot be used: No such device"),
    ],
)
def test_every_refusal_of_the_kernel_is_a_sentence(number: int, kind: type[DeviceError], words: str) -> None:
    kernel = FakeKernel(ManualClock())
    kernel.error = OSError(number, "No such device")
    with pytest.raises(kind, match=words):
        GpioRelays(kernel, RelaysOptions(lines=(5,)))
    with pytest.raises(kind, match=words):
        GpioButton(kernel, ButtonOptions(line=17), kernel.clock)


def test_closing_releases_the_lines_once() -> None:
    """Another program can then use them."""
    kernel = FakeKernel(ManualClock())
    relays = GpioRelays(kernel, RelaysOptions(lines=(5,)))
    relays.close()
    relays.close()

    assert kernel.releases == 1


def test_a_line_says_when_to_lift_and_another_that_the_press_is_too_deep() -> None:
    """Each only while it is so, and none in a station that is not ready or whose loop hangs."""
    kernel = FakeKernel(clock := ManualClock())
    rules = [OutputRule(1, frozenset({"lift"})), OutputRule(2, frozenset({"overload"}))]
    driver = ActuatorDriver(
        lambda: GpioRelays(kernel, RelaysOptions(lines=(5, 6))), rules, clock, print, print, watchdog_ns=10**9
    )
    for state, contact, on in (
        ("ready", "judged", set()),
        ("ready", "lift", {5}),
        ("ready", "overload", {6}),
        ("halted", "lift", set()),
        ("ready", "unknown", set()),
        ("ready", "lift", {5}),
    ):
        driver.show(StationView(state, contact=contact))  # type: ignore[arg-type]
        driver.step()
        assert {line for line, level in kernel.levels.items() if level} == on, (state, contact)
    clock.sleep(1.1)
    driver.step()
    assert not any(kernel.levels.values())
