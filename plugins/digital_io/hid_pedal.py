"""Foot pedals and buttons that act as keyboards.

# Ref: USB HID 1.11 appendix B.1 (boot keyboard report: modifiers, reserved, six keys); ids from
# github.com/rgerganov/footswitch. Not seen on a pedal by us: the reports are those of the standard.

A pedal types its key into whatever has the keyboard's focus as well. Program a key that nothing uses, such as F13.
"""

from typing import Final

from pydantic import BaseModel, Field

from edge.core.digital_io import DiscoveredPort
from edge.core.errors import DeviceNotFound
from edge.core.ports import Clock
from plugins.digital_io import PortPlugin
from plugins.digital_io.hid_bus import HidBus, HidInfo, HidPort, SystemHidBus

__all__ = ["PEDALS", "HidPedal", "PedalOptions", "discover_pedals", "open_pedal", "plugin"]

PEDALS: Final = {"0c45:7403", "0c45:7404", "413d:2107", "1a86:e026", "3553:b001"}
KEYBOARD: Final = (1, 6)  # usage page generic desktop, usage keyboard
# The six keys of a boot keyboard report, and the most bytes of one with a report id.
_KEYS, _MOST = slice(2, 8), 64
_ROLL_OVER: Final = {1, 2, 3}  # usages for "too many keys" and two faults


class PedalOptions(BaseModel, extra="forbid", frozen=True):
    """Which pedal, and which key of it. It types as well: give it a key that nothing else uses."""

    device: str | None = Field(
        default=None,
        pattern="^[0-9a-f]{4}:[0-9a-f]{4}$",
        description="vendor and product id, such as `0c45:7404`; by default any known pedal",
    )
    serial: str | None = Field(default=None, min_length=1, description="of the pedal, if it has one")
    key: int | None = Field(
        default=None, ge=4, le=0xE7, description="HID usage of the key that counts; by default any key"
    )


class HidPedal(HidPort):
    """An open pedal."""

    def __init__(self, bus: HidBus, info: HidInfo, clock: Clock, key: int | None) -> None:
        super().__init__(bus, info)
        self._clock, self._key = clock, key
        self._is_down = False

    def read(self, deadline_ns: int) -> bool | None:
        handle = self.handle
        while True:
            left_ns = deadline_ns - self._clock.monotonic_ns()
            report = handle.read(_MOST, max(0, left_ns) / 1e9)
            if report and (is_down := self._presses(report)) != self._is_down:
                self._is_down = is_down
                return is_down
            if not report or left_ns <= 0:
                return None

    def _presses(self, report: bytes) -> bool:
        """A report of nine bytes has its id first."""
        boot = report[1:] if len(report) == 9 else report
        keys = {*boot[_KEYS], *_modifiers(boot)} - {0} - _ROLL_OVER
        return bool(keys) if self._key is None else self._key in keys


def _modifiers(boot: bytes) -> list[int]:
    """The usages of the keys in the first byte: left control is 0xE0."""
    return [0xE0 + bit for bit in range(8) if boot and boot[0] >> bit & 1]


def discover_pedals(bus: HidBus, options: PedalOptions) -> list[tuple[HidInfo, DiscoveredPort]]:
    """List every interface of the wanted pedals, with the reason why one cannot be used."""
    wanted = PEDALS if options.device is None else {options.device}
    return [
        (info, DiscoveredPort(info.place, info.product, info.serial or None, _refusal(info, options)))
        for info in bus.enumerate()
        if info.ids in wanted
    ]


def _refusal(info: HidInfo, options: PedalOptions) -> str | None:
    if info.usage not in (KEYBOARD, (0, 0)):
        return f"{info.place}: this interface of {info.product} is no keyboard (usage {info.usage})"
    if options.serial is not None and info.serial != options.serial:
        return f"{info.place}: {info.product} has the serial '{info.serial}', expected '{options.serial}'"
    return None


def open_pedal(bus: HidBus, options: PedalOptions, clock: Clock) -> HidPedal:
    """The first usable one. Errors: DeviceNotFound, DeviceBusy, DeviceLost."""
    pedals = discover_pedals(bus, options)
    usable = [info for info, port in pedals if port.refusal is None]
    if not usable:
        seen = "; ".join(port.refusal for _, port in pedals if port.refusal)
        which = f"pedal {options.device}" if options.device else "pedal"
        raise DeviceNotFound(f"no {which} is plugged in; {seen or 'check its cable, then `gelgate devices`'}")
    return HidPedal(bus, usable[0], clock, options.key)


plugin = PortPlugin(
    PedalOptions,
    discover=lambda options: [port for _, port in discover_pedals(SystemHidBus(), options)],
    open=lambda options, clock: open_pedal(SystemHidBus(), options, clock),
)
