"""A pedal and a relay board that are plugged into nothing: the true drivers on a virtual HID bus.

What it does not simulate: the time that a report takes, the pedal's typing, and the rights to a device.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pydantic import BaseModel, Field, PrivateAttr

from edge.clock import SystemClock
from edge.core.digital_io import DiscoveredPort
from edge.core.errors import DeviceLost
from edge.core.ports import Clock
from plugins.digital_io.dcttech_relay import ON, DcttechRelay, RelayOptions, discover_relays, open_relay
from plugins.digital_io.hid_bus import HidHandle, HidInfo
from plugins.digital_io.hid_pedal import KEYBOARD, HidPedal, PedalOptions, discovered_pedals, open_pedal

__all__ = ["VirtualHidBus", "VirtualHidOptions", "actuator", "trigger"]

BOARD: Final = b"VIRT1"
F13: Final = 0x68
PEDAL_INFO: Final = HidInfo(b"virtual/pedal", 0x0C45, 0x7404, "FootSwitch", usage=KEYBOARD)
RELAY_INFO: Final = HidInfo(b"virtual/relay", 0x16C0, 0x05DF, "USBRelay8")


class VirtualHidOptions(BaseModel, extra="forbid", frozen=True):
    """What happens on the virtual bus. Times are seconds after its first use; opened again, it continues."""

    presses_s: tuple[float, ...] = Field(default=(), description="when the pedal goes down")
    held_s: float = Field(default=0.3, gt=0, le=60, description="how long it stays down")
    unplugged_s: tuple[float, float] | None = Field(
        default=None, description="from when to when the device is unplugged"
    )
    log: Path | None = Field(default=None, description="a file that gets one line of JSON for each switching")

    _bus: "VirtualHidBus | None" = PrivateAttr(default=None)


class VirtualHidBus:
    """One pedal and one board with 8 relays. `is_plugged_in` and `relays` are for tests and demonstrations.

    is_silent: after unplugging, reads and reports do nothing instead of failing, as hidapi was seen to do on Linux.
    """

    def __init__(self, options: VirtualHidOptions, clock: Clock) -> None:
        self.relays = [False] * 8
        self.is_plugged_in = True
        self.is_silent = True
        self.is_stuck = False
        self.options, self.clock = options, clock
        self._started_ns = clock.monotonic_ns()

    @property
    def now_s(self) -> float:
        """Seconds since the first use."""
        return (self.clock.monotonic_ns() - self._started_ns) / 1e9

    def has_devices(self) -> bool:
        """Whether they are plugged in now."""
        away = self.options.unplugged_s
        return self.is_plugged_in and not (away and away[0] <= self.now_s < away[1])

    def enumerate(self) -> list[HidInfo]:
        return [PEDAL_INFO, RELAY_INFO] if self.has_devices() else []

    def open(self, info: HidInfo) -> HidHandle:
        self.check(info)
        return _Pedal(self) if info == PEDAL_INFO else _Board(self)

    def check(self, info: HidInfo) -> None:
        """Errors: DeviceLost when it is unplugged."""
        if not self.has_devices():
            raise DeviceLost(f"{info.product} at {info.place} is gone")

    def switch(self, channel: int, is_on: bool) -> None:
        """One relay, into the log as well."""
        if self.is_stuck:
            return
        self.relays[channel - 1] = is_on
        if self.options.log is not None:
            line = {"at_s": round(self.now_s, 3), "channel": channel, "on": is_on}
            with self.options.log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")


class _Pedal:
    """Its reports are those of a boot keyboard that types F13."""

    def __init__(self, bus: VirtualHidBus) -> None:
        self._bus, self._seen_s = bus, bus.now_s

    def read(self, most: int, timeout_s: float) -> bytes:
        bus = self._bus
        end_s = self._seen_s if timeout_s < 0 else bus.now_s + timeout_s
        following = next((one for one in self._changes() if self._seen_s < one[0] <= end_s), None)
        wait_s = (following[0] if following else end_s) - bus.now_s
        bus.clock.sleep(max(0.0, wait_s))
        if not bus.has_devices():
            return self._gone()
        if following is None:
            return b""
        self._seen_s = following[0]
        return bytes([0, 0, F13 if following[1] else 0, 0, 0, 0, 0, 0])[:most]

    def _gone(self) -> bytes:
        if not self._bus.is_silent:
            raise DeviceLost("FootSwitch at virtual/pedal is gone")
        return b""

    def _changes(self) -> list[tuple[float, bool]]:
        options = self._bus.options
        ups = [(at + options.held_s, False) for at in options.presses_s]
        return sorted([*((at, True) for at in options.presses_s), *ups])

    def send_feature(self, report: bytes) -> None:
        self._bus.check(PEDAL_INFO)

    def get_feature(self, report_id: int, most: int) -> bytes:
        self._bus.check(PEDAL_INFO)
        return b""

    def close(self) -> None:
        """Nothing is held."""


class _Board:
    """The reports of a dcttech board."""

    def __init__(self, bus: VirtualHidBus) -> None:
        self._bus = bus

    def read(self, most: int, timeout_s: float) -> bytes:
        self._bus.clock.sleep(timeout_s)
        return b""

    def send_feature(self, report: bytes) -> None:
        self._bus.check(RELAY_INFO)
        _, command, channel = report[:3]
        self._bus.switch(channel, command == ON)

    def get_feature(self, report_id: int, most: int) -> bytes:
        self._bus.check(RELAY_INFO)
        bits = sum(1 << place for place, is_on in enumerate(self._bus.relays) if is_on)
        return bytes([report_id, *BOARD, 0, 0, bits])[:most]

    def close(self) -> None:
        """Nothing is held."""


def bus_of(options: VirtualHidOptions, clock: Clock | None = None) -> VirtualHidBus:
    """The bus of these options, made at its first use."""
    if options._bus is None:
        options._bus = VirtualHidBus(options, clock or SystemClock())
    return options._bus


class VirtualTrigger:
    """The plugin of the pedal."""

    Options = VirtualHidOptions

    def discover(self, options: VirtualHidOptions) -> Sequence[DiscoveredPort]:
        return discovered_pedals(bus_of(options), PedalOptions())

    def open(self, options: VirtualHidOptions, clock: Clock) -> HidPedal:
        return open_pedal(bus_of(options, clock), PedalOptions(), clock)


class VirtualActuator:
    """The plugin of the board."""

    Options = VirtualHidOptions

    def discover(self, options: VirtualHidOptions) -> Sequence[DiscoveredPort]:
        return [port for _, port in discover_relays(bus_of(options), RelayOptions())]

    def open(self, options: VirtualHidOptions, clock: Clock) -> DcttechRelay:
        return open_relay(bus_of(options, clock), RelayOptions())


trigger = VirtualTrigger()
actuator = VirtualActuator()
