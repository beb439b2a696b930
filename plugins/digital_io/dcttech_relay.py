"""USB relay boards of dcttech, product `USBRelay1` to `USBRelay8`.

# Ref: github.com/pavel-a/usb-relay-hid, github.com/JPEWdev/pyhid-usb-relay. A feature report of 8 bytes: 0xFF n
# switches channel n on, 0xFD n off. Reading it gives the board's name (5 characters) and in byte 7 a bit for each
# relay. All boards have one USB id and one USB serial number, so only that name tells two boards apart.
# Not seen on a board by us. Boards that look alike (CH551G) answer other reports: they are refused by what they answer.
"""

import re
from typing import Final

from pydantic import BaseModel, Field

from edge.core.digital_io import DiscoveredPort
from edge.core.errors import DeviceError, DeviceLost, DeviceNotFound, DeviceStalled
from plugins.digital_io import PortPlugin
from plugins.digital_io.hid_bus import HidBus, HidInfo, HidPort, SystemHidBus

__all__ = ["RELAY_IDS", "DcttechRelay", "RelayOptions", "discover_relays", "open_relay", "plugin"]

RELAY_IDS: Final = "16c0:05df"
ON, OFF = 0xFF, 0xFD
_PRODUCT: Final = re.compile(r"USBRelay([1-8])$")


class RelayOptions(BaseModel, extra="forbid", frozen=True):
    """Which board."""

    serial: str | None = Field(
        default=None,
        pattern="^[!-~]{5}$",
        description="the 5 characters of the board that `gelgate devices` prints, if several are plugged in",
    )


class DcttechRelay(HidPort):
    """An open board. Each write is read back: a board that does not switch is a fault."""

    def __init__(self, bus: HidBus, info: HidInfo) -> None:
        super().__init__(bus, info)
        self.channels = _channels(info)
        try:
            self.serial = self._report()[0]
        except DeviceError:
            self.close()
            raise
        self.name = f"{info.product} {self.serial} at {info.place}"

    def write(self, channel: int, is_on: bool) -> None:
        if not 1 <= channel <= self.channels:
            raise ValueError(f"{self.name} has channels 1 to {self.channels}, found {channel}")
        self.handle.send_feature(bytes([0, ON if is_on else OFF, channel, 0, 0, 0, 0, 0, 0]))
        _, bits = self._report()
        if bool(bits >> (channel - 1) & 1) != is_on:
            raise DeviceStalled(
                f"{self.name} did not switch channel {channel} {'on' if is_on else 'off'}; check its supply"
            )

    def _report(self) -> tuple[str, int]:
        """The board's name and its relays as bits. Errors: DeviceLost; DeviceNotFound for another kind of board."""
        report = self.handle.get_feature(0, 9)
        data = report[1:] if len(report) == 9 else report
        name = data[:5].decode("ascii", errors="replace")
        if not data:
            raise DeviceLost(f"{self.name} is gone")
        if len(data) != 8 or not re.fullmatch("[!-~]{5}", name) or data[7] >> self.channels:
            raise DeviceNotFound(
                f"{self.name} has the USB id of a dcttech board and answers "
                f"{data.hex()}, expected 5 characters and its relays in byte 7; use another board"
            )
        return name, data[7]


def _channels(info: HidInfo) -> int:
    matched = _PRODUCT.match(info.product)
    return int(matched[1]) if matched else 0


def discover_relays(bus: HidBus, options: RelayOptions) -> list[tuple[HidInfo, DiscoveredPort]]:
    """Every interface with the boards' USB id. Each board is asked for its name; nothing is switched."""
    return [(info, _discovered(bus, info, options)) for info in bus.enumerate() if info.ids == RELAY_IDS]


def _discovered(bus: HidBus, info: HidInfo, options: RelayOptions) -> DiscoveredPort:
    if not _channels(info):
        refusal = (
            f"{info.place}: '{info.product}' shares the USB id {RELAY_IDS}; a board is named USBRelay1 to 8"
        )
        return DiscoveredPort(info.place, info.product, None, refusal)
    try:
        board = DcttechRelay(bus, info)
    except DeviceError as error:
        return DiscoveredPort(info.place, info.product, None, str(error))
    board.close()
    is_other = options.serial is not None and board.serial != options.serial
    other = f"{info.place}: it is board '{board.serial}', expected '{options.serial}'"
    return DiscoveredPort(info.place, info.product, board.serial, other if is_other else None)


def open_relay(bus: HidBus, options: RelayOptions) -> DcttechRelay:
    """The only board, or that of the options. Errors: DeviceNotFound, DeviceBusy, DeviceLost."""
    boards_seen = discover_relays(bus, options)
    usable = [(info, port) for info, port in boards_seen if port.refusal is None]
    if not usable:
        seen = "; ".join(port.refusal for _, port in boards_seen if port.refusal)
        raise DeviceNotFound(
            f"no relay board is plugged in; {seen or 'check its cable, then `gelgate devices`'}"
        )
    if len(usable) > 1:
        boards = ", ".join(str(port.serial) for _, port in usable)
        raise DeviceNotFound(
            f"several relay boards are plugged in ({boards}); choose one with options.serial"
        )
    return DcttechRelay(bus, usable[0][0])


plugin = PortPlugin(
    RelayOptions,
    discover=lambda options: [port for _, port in discover_relays(SystemHidBus(), options)],
    open=lambda options, clock: open_relay(SystemHidBus(), options),
)
