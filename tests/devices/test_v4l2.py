"""The path through the kernel: the right node, the controls by either name, and the meaning of OpenCV's answers."""

import os
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_recordings import PRODUCT, SERIAL, jpeg

from edge.clock import ManualClock
from edge.core.errors import DeviceBusy, DeviceLost, DeviceNotFound, DeviceStalled, FrameCorrupt
from edge.core.ports import Device, DeviceIdentity, DiscoveredDevice
from plugins.devices import gelsight_mini
from plugins.devices.gelsight_mini import GelsightMiniOptions
from plugins.devices.uvc.identity import SensorOnBus
from plugins.devices.v4l2.controls import control_ids, control_name, pin_v4l2_controls
from plugins.devices.v4l2.sensor import V4l2Sensor, capture_node, open_capture, video_nodes

IDENTITY = DeviceIdentity(PRODUCT, SERIAL, (64, 48), 25.0)


def plug(
    root: Path, number: int, *, product: str, serial: str, port: str, index: int = 0, by_id: bool = True
) -> None:
    """A camera in a made-up /sys and /dev, laid out as on Linux 6.1."""
    usb = root / f"sys/devices/pci/usb1/{port}"
    interface = usb / f"{port}:1.0"
    node = interface / f"video4linux/video{number}"
    node.mkdir(parents=True)
    for name, text in (("idVendor", "0c45"), ("idProduct", "636d"), ("product", product), ("serial", serial)):
        (usb / name).write_text(text + "\n")
    (node / "name").write_text(f"{product}: {product}"[:31] + "\n")
    (node / "index").write_text(f"{index}\n")
    (node / "device").symlink_to(interface)
    folder = root / "sys/class/video4linux"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"video{number}").symlink_to(node)
    (root / "dev/v4l/by-id").mkdir(parents=True, exist_ok=True)
    (root / f"dev/video{number}").touch()
    if by_id:
        (root / f"dev/v4l/by-id/usb-x_{serial}-video-index{index}").symlink_to(root / f"dev/video{number}")


class TestNodes:
    def test_index_0_of_the_right_sensor(self, tmp_path: Path) -> None:
        """Webcam first, metadata twin before the capture node, a second sensor: the right node, by its stable link."""
        plug(tmp_path, 0, product="USB 2.0 Camera", serial="SN0001", port="1-1")
        plug(tmp_path, 2, product=PRODUCT, serial=SERIAL, port="1-2", index=1)
        plug(tmp_path, 10, product=PRODUCT, serial=SERIAL, port="1-2", index=0)
        plug(tmp_path, 3, product="GelSight Mini R0B 28D8-PXEC", serial="28D8PXEC", port="1-3")
        node = capture_node(SERIAL, tmp_path / "sys", tmp_path / "dev")
        assert (node.product, node.index) == (PRODUCT, 0)
        assert node.path.name == f"usb-x_{SERIAL}-video-index0"
        assert node.path.resolve() == tmp_path / "dev/video10"

    def test_without_links_the_node_itself(self, tmp_path: Path) -> None:
        plug(tmp_path, 4, product=PRODUCT, serial=SERIAL, port="1-2", by_id=False)
        assert capture_node(SERIAL, tmp_path / "sys", tmp_path / "dev").path == tmp_path / "dev/video4"

    def test_metadata_alone_is_not_enough(self, tmp_path: Path) -> None:
        """A node that cannot stream is named in the refusal."""
        plug(tmp_path, 1, product=PRODUCT, serial=SERIAL, port="1-2", index=1)
        with pytest.raises(DeviceNotFound, match="index 1"):
            capture_node(SERIAL, tmp_path / "sys", tmp_path / "dev")

    def test_nodes_without_usb_are_left_out(self, tmp_path: Path) -> None:
        """A camera that is not on USB is ignored; without a node the list is empty."""
        assert video_nodes(tmp_path / "sys", tmp_path / "dev") == []
        (tmp_path / "sys/devices/platform/video4linux/video7").mkdir(parents=True)
        (tmp_path / "sys/class/video4linux").mkdir(parents=True)
        (tmp_path / "sys/class/video4linux/video7").symlink_to(
            tmp_path / "sys/devices/platform/video4linux/video7"
        )
        assert video_nodes(tmp_path / "sys", tmp_path / "dev") == []


class FakeControls:
    """The ioctls of a camera with these controls: title to [id, value, maximum]."""

    def __init__(self, controls: dict[str, list[int]]) -> None:
        self._by_id = {
            entry[0]: (title, entry) for title, entry in sorted(controls.items(), key=lambda c: c[1][0])
        }

    def __call__(self, fd: int, request: int, argument: bytes) -> bytes:
        if request & 0xFF == 36:
            return self._query(struct.unpack_from("=I", argument)[0] & 0x7FFFFFFF)
        number, value = struct.unpack("=Ii", argument)
        if request & 0xFF == 28:
            if value > self._by_id[number][1][2]:
                raise OSError(34, "Numerical result out of range")
            self._by_id[number][1][1] = value
        return struct.pack("=Ii", number, self._by_id[number][1][1])

    def _query(self, after: int) -> bytes:
        number = next((known for known in self._by_id if known > after), None)
        if number is None:
            raise OSError(22, "Invalid argument")
        title, (_, value, maximum) = self._by_id[number]
        return struct.pack("=II32siiiiI8x", number, 1, title.encode(), 0, maximum, 1, value, 0)


class TestControls:
    @pytest.fixture
    def node(self, tmp_path: Path) -> Path:
        (tmp_path / "video0").touch()
        return tmp_path / "video0"

    @pytest.mark.parametrize(
        ("title", "name"),
        [
            ("Exposure Time, Absolute", "exposure_time_absolute"),
            ("Exposure (Absolute)", "exposure_absolute"),
            ("White Balance Temperature, Auto", "white_balance_temperature_auto"),
            ("Gamma", "gamma"),
        ],
    )
    def test_names_as_v4l2_ctl_prints_them(self, title: str, name: str) -> None:
        """Lower case, one underscore for everything else."""
        assert control_name(title) == name

    @pytest.mark.parametrize("wish", ["exposure_absolute", "exposure_time_absolute"])
    @pytest.mark.parametrize("title", ["Exposure (Absolute)", "Exposure Time, Absolute"])
    def test_old_and_new_names_mean_the_same(self, node: Path, wish: str, title: str) -> None:
        """A profile with old or new names works on an old or new kernel."""
        camera = FakeControls({title: [0x9A0902, 157, 5000]})
        assert pin_v4l2_controls(node, {wish: 180}, camera) == {}
        assert struct.unpack("=Ii", camera(0, 27, struct.pack("=Ii", 0x9A0902, 0)))[1] == 180

    def test_what_was_not_set_is_reported(self, node: Path) -> None:
        """Missing, out of range, or found otherwise when it is read back: named with the reason, the others are set."""

        class Stubborn(FakeControls):
            def __call__(self, fd: int, request: int, argument: bytes) -> bytes:
                return argument if request & 0xFF == 28 else super().__call__(fd, request, argument)

        camera = FakeControls({"Gain": [1, 5, 100], "Gamma": [2, 100, 500]})
        unset = pin_v4l2_controls(node, {"gain": 0, "gamma": 900, "zoom": 1}, camera)
        assert set(unset) == {"gamma", "zoom"}
        assert "Numerical result out of range" in unset["gamma"]
        assert control_ids(0, camera) == {"gain": 1, "gamma": 2}
        unset = pin_v4l2_controls(node, {"gain": 2**31, "gamma": 200}, camera)
        assert set(unset) == {"gain"}
        unset = pin_v4l2_controls(node, {"gain": 7}, Stubborn({"Gain": [1, 5, 100]}))
        assert unset == {"gain": "set to 7, reads back 5"}
        assert pin_v4l2_controls(node / "nowhere", {}) == {}


class FakeCapture:
    """OpenCV's capture with the conversion off: payloads as (1, n) uint8, then always False."""

    def __init__(self, *payloads: bytes) -> None:
        self._payloads = list(payloads)
        self.released = 0

    def read(self) -> tuple[bool, object]:
        if not self._payloads:
            return False, None
        return True, np.frombuffer(self._payloads.pop(0), np.uint8)[None]

    def release(self) -> None:
        self.released += 1


def sensor_with(
    capture: FakeCapture, clock: ManualClock, *, present: bool = True
) -> tuple[V4l2Sensor, list[str]]:
    closed: list[str] = []
    sensor = V4l2Sensor(
        IDENTITY, capture, clock, is_present=lambda: present, on_close=lambda: closed.append("lock")
    )
    return sensor, closed


class TestSensor:
    def test_bytes_are_the_cameras(self) -> None:
        """Frames are new, in order, untouched; a repeated one is dropped and counted."""
        clock = ManualClock()
        sensor, _ = sensor_with(FakeCapture(jpeg(0), jpeg(0), jpeg(1)), clock)
        frames = [sensor.read(clock.monotonic_ns() + 1) for _ in range(2)]
        assert isinstance(sensor, Device)
        assert [(frame.payload, frame.sequence) for frame in frames] == [(jpeg(0), 0), (jpeg(1), 1)]
        assert sensor.stale == 1

    @pytest.mark.parametrize(("present", "says"), [(True, "stopped sending"), (False, "was unplugged")])
    def test_the_first_false_is_the_end(self, present: bool, says: str) -> None:
        """After an unplug OpenCV always gives False: one DeviceLost, decided by asking the bus, and no busy loop."""
        clock = ManualClock()
        sensor, _ = sensor_with(FakeCapture(jpeg(0)), clock, present=present)
        sensor.read(clock.monotonic_ns() + 1)
        for _ in range(2):
            with pytest.raises(DeviceLost, match=says):
                sensor.read(clock.monotonic_ns() + 1)

    @pytest.mark.parametrize(
        ("payload", "says"),
        [(jpeg(0)[:-20], "FFD9"), (jpeg(0, (32, 32)), r"\(32, 32\)"), (b"\x00" * 100, "not a JPEG")],
    )
    def test_a_bad_frame_is_corrupt(self, payload: bytes, says: str) -> None:
        """Cut, of another size, or converted by OpenCV after all; the next is good."""
        clock = ManualClock()
        sensor, _ = sensor_with(FakeCapture(payload, jpeg(1)), clock)
        with pytest.raises(FrameCorrupt, match=says):
            sensor.read(clock.monotonic_ns() + 1)
        assert sensor.read(clock.monotonic_ns() + 1).payload == jpeg(1)

    def test_a_repeated_frame_is_stalled(self) -> None:
        """A driver that repeats its buffer is not taken for a live camera."""
        clock = ManualClock()

        class Stuck(FakeCapture):
            def read(self) -> tuple[bool, object]:
                clock.sleep(0.05)
                return True, np.frombuffer(jpeg(0), np.uint8)[None]

        sensor, _ = sensor_with(Stuck(), clock)
        sensor.read(clock.monotonic_ns() + 10**9)
        with pytest.raises(DeviceStalled, match="repeats the same frame"):
            sensor.read(clock.monotonic_ns() + 10**9)

    def test_close_gives_back_once(self) -> None:
        capture = FakeCapture(jpeg(0))
        sensor, closed = sensor_with(capture, ManualClock())
        sensor.close()
        sensor.close()
        assert (capture.released, closed) == (1, ["lock"])

    def test_a_node_that_does_not_open_is_busy(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """OpenCV gives no reason; the message names the two usual ones."""
        monkeypatch.setitem(os.environ, "OPENCV_LOG_LEVEL", "SILENT")
        (tmp_path / "video0").touch()
        with pytest.raises(DeviceBusy, match="group video"):
            open_capture(tmp_path / "video0", (64, 48))


def test_a_sensor_without_a_usb_serial_has_that_of_its_product(tmp_path: Path) -> None:
    """As where it is found on the bus: else it would be there, and have no node."""
    plug(tmp_path, 0, product=PRODUCT, serial="", port="1-1")
    node = capture_node(SERIAL, tmp_path / "sys", tmp_path / "dev")
    assert node.path.resolve() == tmp_path / "dev/video0"


def test_a_node_that_vanishes_while_it_is_opened_is_a_device_that_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is tried again; any other error would end the gateway."""
    released = list[str]()
    capture = SimpleNamespace(release=lambda: released.append("capture"))
    monkeypatch.setattr(gelsight_mini, "SensorLock", lambda _: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(gelsight_mini, "capture_node", lambda _: SimpleNamespace(path=tmp_path / "video0"))
    monkeypatch.setattr(gelsight_mini, "open_capture", lambda *_: capture)
    found = SensorOnBus(None, DiscoveredDevice("bus 1", PRODUCT, IDENTITY))
    backend: Any = None
    options = GelsightMiniOptions(controls={"gain": 1})

    with pytest.raises(DeviceLost, match=f"{PRODUCT}: No such file"):
        gelsight_mini._open_v4l2(backend, found, options, ManualClock())
    assert released == ["capture"]
