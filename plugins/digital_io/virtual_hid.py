"""A pedal and a relay board that are plugged into nothing: the true drivers on a virtual HID bus.

What it does not simulate: the time that a report takes, the pedal's typing, and the rights to a device.
"""

import json
import math
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

from edge.clock import SystemClock
from edge.core.errors import DeviceLost
from edge.core.ports import Clock
from plugins.digital_io import PortPlugin
from plugins.digital_io.dcttech_relay import ON, RelayOptions, discover_relays, open_relay
from plugins.digital_io.hid_bus import HidHandle, HidInfo
from plugins.digital_io.hid_pedal import KEYBOARD, PedalOptions, discover_pedals, open_pedal

__all__ = ["VirtualHidBus", "VirtualHidOptions", "actuator", "bus_of", "trigger"]

BOARD: Final = b"VIRT1"
F13: Final = 0x68
PEDAL_INFO: Final = HidInfo(b"virtual/pedal", 0x0C45, 0x7404, "FootSwitch", usage=KEYBOARD)
RELAY_INFO: Final = HidInfo(b"virtual/relay", 0x16C0, 0x05DF, "USBRelay8")


class VirtualHidOptions(BaseModel):
    """What happens on the virtual bus. Times are seconds after its first use; opened again, it continues."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    presses_s: tuple[float, ...] = Field(default=(), description="when the pedal goes down")
    held_s: float = Field(default=0.3, gt=0, le=60, description="how long it stays down")
    unplugged_s: tuple[float, float] | None = Field(
        default=None, description="from when to when the device is unplugged"
    )
    log: Path | None = Field(default=None, description="a file that gets one line of JSON for each switching")

    _bus: "VirtualHidBus | None" = PrivateAttr(default=None)


class VirtualHidBus:
    """One pedal and one board with 8 relays. Its attributes are for tests and demonstrations.

    is_stuck: the relays do not switch. is_silent: without its cable the pedal reads as empty instead of failing, as
    hidapi was seen to do on Linux.
    """

    def __init__(self, options: VirtualHidOptions, clock: Clock) -> None:
        self.relays = [False] * 8
        self.is_plugged_in = True
        self.is_silent = True
        self.is_stuck = False
        self.pedal_is_down = False
        self.options, self.clock = options, clock
        self._started_ns = clock.monotonic_ns()

    @property
    def now_s(self) -> float:
        """Seconds since the first use."""
        return (self.clock.monotonic_ns() - self._started_ns) / 1e9

    def has_devices(self) -> bool:
        """True while they are plugged in."""
        away = self.options.unplugged_s
        return self.is_plugged_in and not (away and away[0] <= self.now_s < away[1])

    def is_down(self) -> bool:
        """True while the pedal is pressed, by its script or by hand."""
        now_s, held_s = self.now_s, self.options.held_s
        return self.pedal_is_down or any(at <= now_s < at + held_s for at in self.options.presses_s)

    def next_change_s(self) -> float:
        """Seconds until the script changes the pedal."""
        edges = [at + after for at in self.options.presses_s for after in (0.0, self.options.held_s)]
        return min((edge - self.now_s for edge in edges if edge > self.now_s), default=math.inf)

    def enumerate(self) -> list[HidInfo]:
        return [PEDAL_INFO, RELAY_INFO] if self.has_devices() else []

    def open(self, info: HidInfo) -> HidHandle:
        self.check(info)
        return _Pedal(self) if info == PEDAL_INFO else _Board(self)

    def check(self, info: HidInfo) -> None:
        """Refuse an unplugged interface. Errors: DeviceLost."""
        if not self.has_devices():
            raise DeviceLost(f"{info.product} at {info.place} is gone")

    def switch(self, channel: int, is_on: bool) -> None:
        """Switch one relay, and log it."""
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
        self._bus, self._is_down = bus, bus.is_down()

    def read(self, most: int, timeout_s: float) -> bytes:
        bus = self._bus
        if bus.is_down() == self._is_down:
            bus.clock.sleep(min(timeout_s, bus.next_change_s()))
        if not bus.has_devices():
            if not bus.is_silent:
                raise DeviceLost("FootSwitch at virtual/pedal is gone")
            return b""
        if bus.is_down() == self._is_down:
            return b""
        self._is_down = bus.is_down()
        return bytes([0, 0, F13 if self._is_down else 0, 0, 0, 0, 0, 0])[:most]

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


trigger = PortPlugin(
    VirtualHidOptions,
    discover=lambda options: [port for _, port in discover_pedals(bus_of(options), PedalOptions())],
    open=lambda options, clock: open_pedal(bus_of(options, clock), PedalOptions(), clock),
)
actuator = PortPlugin(
    VirtualHidOptions,
    discover=lambda options: [port for _, port in discover_relays(bus_of(options), RelayOptions())],
    open=lambda options, clock: open_relay(bus_of(options, clock), RelayOptions()),
)
