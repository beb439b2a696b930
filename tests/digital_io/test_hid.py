"""The pedal and the relay board on the virtual bus, and what else has their USB ids."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from edge.clock import ManualClock
from edge.core.errors import DeviceNotFound, DeviceStalled
from plugins.digital_io.dcttech_relay import RelayOptions, discover_relays, open_relay
from plugins.digital_io.hid_bus import HidHandle, HidInfo
from plugins.digital_io.hid_pedal import KEYBOARD, PedalOptions, discover_pedals, open_pedal
from plugins.digital_io.virtual_hid import (
    RELAY_INFO,
    VirtualHidBus,
    VirtualHidOptions,
    actuator,
    bus_of,
    trigger,
)


class Reports:
    """A bus of these interfaces; each read or feature report is the next of `reports`."""

    def __init__(self, infos: Sequence[HidInfo], *reports: bytes) -> None:
        self.infos, self.reports = list(infos), list(reports)
        self.closings = 0

    def enumerate(self) -> list[HidInfo]:
        return self.infos

    def open(self, info: HidInfo) -> HidHandle:
        return self

    def read(self, most: int, timeout_s: float) -> bytes:
        return self.reports.pop(0) if self.reports else b""

    def send_feature(self, report: bytes) -> None:
        """Taken, and without effect."""

    def get_feature(self, report_id: int, most: int) -> bytes:
        return self.reports.pop(0) if self.reports else b""

    def close(self) -> None:
        self.closings += 1


PEDAL = HidInfo(b"/dev/hidraw1", 0x413D, 0x2107, "FootSwitch", usage=KEYBOARD)
MOUSE = HidInfo(b"/dev/hidraw0", 0x413D, 0x2107, "FootSwitch", usage=(1, 2))
SENSOR = HidInfo(b"/dev/hidraw2", 0x0C45, 0x636D, "GelSight Mini R0B")


def keys(*usages: int, modifiers: int = 0) -> bytes:
    return bytes([modifiers, 0, *usages, *[0] * (6 - len(usages))])


def presses(options: PedalOptions, *reports: bytes) -> list[bool | None]:
    pedal = open_pedal(Reports([PEDAL], *reports), options, ManualClock())
    return [pedal.read(10**12) for _ in reports]


@pytest.mark.parametrize(
    ("options", "reports", "read"),
    [
        # Down, the same again, another key with it, up.
        ({}, [keys(0x68), keys(0x68), keys(0x68, 5), keys()], [True, False, None, None]),
        # Of a pedal with three switches the others do not count; a modifier has a usage too.
        ({"key": 5}, [keys(4), keys(4, 5), keys(5), keys(4)], [True, False, None, None]),
        ({"key": 0xE1}, [keys(modifiers=2), keys()], [True, False]),
        # Nine bytes have the id first; usage 1 in all places is no key.
        ({}, [bytes([1]) + keys(0x68), bytes([1]) + keys()], [True, False]),
        ({}, [keys(1, 1, 1, 1, 1, 1)], [None]),
    ],
)
def test_changes_of_a_pedal_are_read_from_its_reports(
    options: dict[str, int], reports: list[bytes], read: list[bool | None]
) -> None:
    """Any key counts, or the one that is chosen; a repeated report does not."""
    assert presses(PedalOptions.model_validate(options), *reports) == read


def test_the_sensor_and_a_mouse_are_no_pedals() -> None:
    """The sensor's vendor id is that of a pedal's maker; a pedal shows a mouse as well."""
    found = discover_pedals(Reports([MOUSE, PEDAL, SENSOR]), PedalOptions())

    assert [(info.place, port.refusal) for info, port in found] == [
        ("/dev/hidraw0", "/dev/hidraw0: this interface of FootSwitch is no keyboard (usage (1, 2))"),
        ("/dev/hidraw1", None),
    ]


def test_a_missing_pedal_is_one_sentence() -> None:
    with pytest.raises(DeviceNotFound, match="no pedal is plugged in; check its cable"):
        open_pedal(Reports([SENSOR]), PedalOptions(), ManualClock())
    with pytest.raises(DeviceNotFound, match="has the serial '', expected 'A1'"):
        open_pedal(Reports([PEDAL]), PedalOptions(serial="A1"), ManualClock())


def test_a_board_that_answers_otherwise_is_refused_and_released() -> None:
    """The clones have the same USB id and another protocol."""
    bus = Reports([RELAY_INFO], bytes.fromhex("f101000000000000"))
    with pytest.raises(
        DeviceNotFound, match="has the USB id of a dcttech board and answers f101000000000000"
    ):
        open_relay(bus, RelayOptions())
    assert bus.closings == 1


def test_a_board_is_known_by_name_and_by_its_report() -> None:
    """Nine bytes or eight, as systems differ; the USB id is shared by many devices of one firmware library."""
    for report in (b"\0QWERT\0\0\x05", b"QWERT\0\0\x05"):
        ((_, port),) = discover_relays(Reports([RELAY_INFO], report), RelayOptions())
        assert (port.serial, port.refusal) == ("QWERT", None)
    other = HidInfo(b"/dev/hidraw7", 0x16C0, 0x05DF, "Thermometer")
    ((_, port),) = discover_relays(Reports([other]), RelayOptions())
    shared = "/dev/hidraw7: 'Thermometer' shares the USB id 16c0:05df; a board is named USBRelay1 to 8"
    assert port.refusal == shared


def test_two_boards_must_be_told_apart() -> None:
    """By the characters in their reports: their USB serial numbers are equal."""
    second = HidInfo(b"virtual/relay2", 0x16C0, 0x05DF, "USBRelay8")
    reports = [b"AAAAA\0\0\0", b"BBBBB\0\0\0"]
    with pytest.raises(DeviceNotFound, match=r"several relay boards are plugged in \(AAAAA, BBBBB\)"):
        open_relay(Reports([RELAY_INFO, second], *reports), RelayOptions())

    board = open_relay(Reports([RELAY_INFO, second], *reports, b"BBBBB\0\0\0"), RelayOptions(serial="BBBBB"))
    assert board.name == "USBRelay8 BBBBB at virtual/relay2"


def test_a_relay_that_does_not_switch_is_a_fault() -> None:
    bus = VirtualHidBus(VirtualHidOptions(), ManualClock())
    board = open_relay(bus, RelayOptions())
    board.write(3, True)
    assert bus.relays[2]
    bus.is_stuck = True
    with pytest.raises(DeviceStalled, match="did not switch channel 3 off; check its supply"):
        board.write(3, False)


def test_the_virtual_pedal_follows_its_script() -> None:
    """Down at 1 s and 2 s, for 0.3 s each."""
    clock = ManualClock(0)
    pedal = trigger.open(VirtualHidOptions(presses_s=(1.0, 2.0)), clock)
    found = []
    while clock.monotonic_ns() < 3e9:
        if (change := pedal.read(clock.monotonic_ns() + 250_000_000)) is not None:
            found.append((round(clock.monotonic_ns() / 1e9, 3), change))

    assert found == [(1.0, True), (1.3, False), (2.0, True), (2.3, False)]


def test_the_virtual_board_keeps_a_log(tmp_path: Path) -> None:
    """One line for each switching, with the seconds since its first use."""
    options, clock = VirtualHidOptions(log=tmp_path / "log.jsonl", unplugged_s=(5, 6)), ManualClock(0)
    board = actuator.open(options, clock)
    clock.sleep(1.5)
    board.write(2, True)
    clock.sleep(4)

    assert json.loads((tmp_path / "log.jsonl").read_text()) == {"at_s": 1.5, "channel": 2, "on": True}
    assert not board.is_present()
    assert bus_of(options).enumerate() == []
