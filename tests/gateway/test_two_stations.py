"""Two sensors on one computer: two stations, each with its sensor by serial, its database and its topics."""

from pathlib import Path

import pytest
from small_recordings import jpeg
from station import station_config
from stepped_station import SteppedStation

from edge.clock import ManualClock
from edge.config import load_config
from edge.core.errors import DeviceLost, DeviceNotFound
from edge.gateway.preflight import preflight
from edge.store.press_store import Store
from plugins.devices.uvc.identity import choose, discover
from plugins.devices.uvc.stream import UvcSensor
from plugins.devices.virtual.bus import VirtualBus
from plugins.devices.virtual.camera import VirtualCamera
from plugins.devices.virtual.descriptors import Board

LEFT, RIGHT = "LEFT0001", "RIGH0002"
# Of five frames each: more than the recording has, so that a station without its sensor fails and does not hang.
TURNS = 40


def configure(folder: Path, recording: Path, bundle: Path, serial: str | None, neighbour: str) -> Path:
    """The configuration of the station in this folder; the other sensor is on its bus too."""
    config = station_config(folder, recording, bundle, tables=f'[station]\nstation = "{folder.name}"')
    own = "" if serial is None else f'serial = "{serial}", '
    text = config.read_text().replace("recording =", f'{own}neighbours = ["{neighbour}"], recording =')
    config.write_text(text)
    return config


def test_each_station_counts_on_its_own_sensor(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Turn by turn on one computer: presses, gels and messages of one are never those of the other."""
    left = configure(tmp_path / "left", recording, bundle, LEFT, RIGHT)
    right = configure(tmp_path / "right", recording, bundle, RIGHT, LEFT)
    with SteppedStation(left) as one, SteppedStation(right) as other:
        for _ in range(TURNS):
            one.play(5)
            other.play(5)
        assert (one.has_ended, other.has_ended) == (True, True)

    for running, name, serial in ((one, "left", LEFT), (other, "right", RIGHT)):
        assert [(result.station, result.sensor_serial) for result in running.results] == [(name, serial)] * 3
        with Store(tmp_path / name / "gelgate.db") as store:
            assert [(gel.serial, gel.presses) for gel in store.gels()] == [(serial, 3)]


def test_a_station_without_a_serial_refuses_to_choose(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Both serials are in the sentence, so that one can be copied into the configuration."""
    config = load_config(configure(tmp_path / "left", recording, bundle, None, RIGHT))
    with preflight(config, ManualClock()) as checked:
        (fault,) = [finding for finding in checked.findings if isinstance(finding.error, DeviceNotFound)]

    assert "2 sensors are plugged in (" in fault.text
    assert RIGHT in fault.text
    assert "name one by its serial" in fault.text


def test_two_sensors_of_one_bus_deliver_their_own_frames(tmp_path: Path) -> None:
    """Read in turn; when one is unplugged the other goes on."""
    clock = ManualClock()
    bus = VirtualBus(clock)
    payloads = {LEFT: [jpeg(n) for n in range(8)], RIGHT: [jpeg(n) for n in range(100, 108)]}
    cameras = {}
    for port, serial in enumerate(payloads, 1):
        board = Board(f"GelSight Mini R0B {serial[:4]}-{serial[4:]}", serial, ((64, 48, 25.0),))
        cameras[serial] = VirtualCamera(board, payloads[serial], clock, port=port, pace=0)
        bus.plug_in(cameras[serial])
    opened = {
        serial: UvcSensor.open(
            bus, choose(discover(bus), serial), clock, lock_name=f"virtual-{tmp_path}-{serial}"
        )
        for serial in payloads
    }
    try:
        for _ in range(3):
            for serial, sensor in opened.items():
                assert sensor.read(clock.monotonic_ns() + 10**9).payload in payloads[serial]
        cameras[LEFT].unplug()
        with pytest.raises(DeviceLost):
            opened[LEFT].read(clock.monotonic_ns() + 10**9)
        assert opened[RIGHT].read(clock.monotonic_ns() + 10**9).payload in payloads[RIGHT]
    finally:
        for sensor in opened.values():
            sensor.close()
