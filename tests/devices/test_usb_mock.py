"""The virtual sensor as pyusb sees it, and the effect of each scripted fault."""

import errno
import os
from pathlib import Path

import pytest
import usb.core
import usb.util
from small_recordings import SERIAL, jpeg, write_recording

from edge.clock import ManualClock
from edge.core.errors import (
    DeviceBusy,
    DeviceLost,
    DeviceNotFound,
    DeviceStalled,
    FrameCorrupt,
    RecordingEnded,
)
from edge.core.imaging.image_bytes import with_comment
from edge.core.ports import Device
from plugins.devices.usb_mock import Bench, UsbMockOptions, plugin
from plugins.devices.uvc.identity import choose, discover
from plugins.devices.uvc.uvc import mjpeg_modes
from plugins.devices.virtual.faults import Fault

SECOND = 1_000_000_000


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


def options_for(tmp_path: Path, *faults: str, frames: int = 8, **more: object) -> UsbMockOptions:
    recording = write_recording(tmp_path / "recording", frames)
    return UsbMockOptions.model_validate({"recording": recording, "pace": 0.0, "faults": faults, **more})


def read(device: Device, clock: ManualClock, within_s: float = 5) -> bytes:
    return device.read(clock.monotonic_ns() + round(within_s * SECOND)).payload


def sensor_on(bench: Bench) -> usb.core.Device:
    return next(one.device for one in discover(bench.bus) if one.discovered.identity is not None)


class TestDescriptors:
    def test_pyusb_finds_and_prints_the_sensor(self, tmp_path: Path, clock: ManualClock) -> None:
        """pyusb reads strings and prints the whole tree: two interfaces, eight alternate settings, 500 mA."""
        device = sensor_on(plugin.bench(options_for(tmp_path), clock))
        printed = str(device)
        assert (device.idVendor, device.idProduct, device.bcdDevice) == (0x0C45, 0x636D, 0x0100)
        assert (device.manufacturer, device.serial_number) == ("Arducam Technology Co., Ltd.", SERIAL)
        assert device.product == "GelSight Mini R0B 2BNN-4ZE7"
        assert "500 mA" in printed
        assert "Isochronous" in printed
        settings = [(i.bInterfaceNumber, i.bAlternateSetting) for i in device.get_active_configuration()]
        assert settings == [(0, 0), *((1, alternate) for alternate in range(8))]

    def test_total_length_is_the_sum_of_all_descriptors(self, tmp_path: Path, clock: ManualClock) -> None:
        """wTotalLength counts every byte that a host would read."""
        configuration = sensor_on(plugin.bench(options_for(tmp_path), clock)).get_active_configuration()
        total = configuration.bLength + len(configuration.extra_descriptors)
        for interface in configuration:
            total += interface.bLength + len(interface.extra_descriptors)
            total += sum(endpoint.bLength + len(endpoint.extra_descriptors) for endpoint in interface)
        assert configuration.wTotalLength == total

    def test_the_one_mode_is_the_recordings(self, tmp_path: Path, clock: ManualClock) -> None:
        """A recording of 3280x2464 frames makes the real sensor's one mode: MJPEG at a nominal 25 fps."""
        folder = write_recording(tmp_path / "r", [jpeg(0, (3280, 2464))], size=(3280, 2464))
        device = sensor_on(plugin.bench(UsbMockOptions(recording=folder), clock))
        streaming = usb.util.find_descriptor(device[0], bInterfaceNumber=1, bAlternateSetting=0)
        (mode,) = mjpeg_modes(bytes(streaming.extra_descriptors))
        assert (mode.width, mode.height, mode.nominal_fps) == (3280, 2464, 25.0)

    def test_webcam_with_the_same_id_is_refused(self, tmp_path: Path, clock: ManualClock) -> None:
        """Both devices have 0c45:636d; only the product string makes a sensor, and the refusal says so."""
        options = options_for(tmp_path)
        plugin.bench(options, clock)
        refused = [one for one in plugin.discover(options) if one.identity is None]
        assert [one.product for one in refused] == ["USB 2.0 Camera"]
        assert "shared by webcams" in (refused[0].refusal or "")
        assert [one.identity.serial for one in plugin.discover(options) if one.identity] == [SERIAL]

    def test_a_webcam_or_another_serial_is_not_opened(self, tmp_path: Path, clock: ManualClock) -> None:
        """The matching id is not enough: the message names what was seen."""
        options = options_for(tmp_path)
        bench = plugin.bench(options, clock)
        with pytest.raises(DeviceNotFound, match=SERIAL):
            choose(discover(bench.bus), "AAAABBBB")
        bench.sensor.unplug()
        with pytest.raises(DeviceNotFound, match=r"USB 2\.0 Camera"):
            plugin.open(options, clock)

    def test_serial_option_changes_the_product_with_it(self, tmp_path: Path, clock: ManualClock) -> None:
        """The product string ends with the serial and a dash, as on real sensors."""
        options = options_for(tmp_path, serial="28D8PXEC")
        (identity,) = (one.identity for one in plugin.discover(options) if one.identity)
        assert (identity.product, identity.serial) == ("GelSight Mini R0B 28D8-PXEC", "28D8PXEC")


class TestKernelDriver:
    def test_claiming_a_bound_interface_is_busy(self, tmp_path: Path, clock: ManualClock) -> None:
        """errno 16 until uvcvideo is detached, as on Linux; identity strings work all the time."""
        device = sensor_on(plugin.bench(options_for(tmp_path), clock))
        assert device.product.startswith("GelSight Mini")
        with pytest.raises(usb.core.USBError) as refused:
            usb.util.claim_interface(device, 1)
        assert refused.value.errno == errno.EBUSY
        device.detach_kernel_driver(0)
        usb.util.claim_interface(device, 1)

    def test_detaching_control_releases_streaming_too(self, tmp_path: Path, clock: ManualClock) -> None:
        """Seen with uvcvideo on a real kernel: both are released together, and bound together."""
        device = sensor_on(plugin.bench(options_for(tmp_path), clock))
        device.detach_kernel_driver(0)
        assert not device.is_kernel_driver_active(1)
        device.attach_kernel_driver(0)
        assert device.is_kernel_driver_active(1)
        with pytest.raises(usb.core.USBError) as refused:
            device.attach_kernel_driver(1)
        assert refused.value.errno == errno.EBUSY

    def test_closing_gives_the_sensor_back_to_the_kernel(self, tmp_path: Path, clock: ManualClock) -> None:
        """After close, uvcvideo is bound, nothing is claimed and the stream is off."""
        options = options_for(tmp_path)
        device = plugin.open(options, clock)
        sensor = plugin.bench(options).sensor
        assert (sensor.alternate, list(sensor.claims)) == (7, [0, 1])
        device.close()
        assert (sensor.alternate, sensor.claims, sensor.kernel_driver) == (0, {}, {0: True, 1: True})

    def test_a_failed_opening_gives_everything_back(self, tmp_path: Path, clock: ManualClock) -> None:
        """Another handle holds the streaming interface: busy, and control is bound to the kernel as before."""
        options = options_for(tmp_path)
        bench = plugin.bench(options, clock)
        other = bench.bus.open_device(bench.sensor)
        bench.bus.detach_kernel_driver(other, 1)
        bench.bus.claim_interface(other, 1)
        with pytest.raises(DeviceBusy):
            plugin.open(options, clock)
        assert list(bench.sensor.claims) == [1]
        bench.bus.close_device(other)
        plugin.open(options, clock).close()


class TestFaults:
    @pytest.mark.parametrize(
        ("fault", "says"),
        [("drop@1", ""), ("stale@1", ""), ("error_bit@1", "error bit"), ("lost_packet@1", "lost on the bus"),
         ("truncate@1", "FFD9")],
    )  # fmt: skip
    def test_one_frame_is_missing(self, tmp_path: Path, clock: ManualClock, fault: str, says: str) -> None:
        """Dropped or repeated it does not come; damaged it is refused, with the reason. The next one follows."""
        device = plugin.open(options_for(tmp_path, fault), clock)
        assert read(device, clock) == jpeg(0)
        if says:
            with pytest.raises(FrameCorrupt, match=says):
                read(device, clock)
        assert read(device, clock) == jpeg(2)

    def test_a_stall_lasts_its_time_or_until_opened_again(self, tmp_path: Path, clock: ManualClock) -> None:
        """Nothing comes, and then the frames go on, none lost."""
        device = plugin.open(options_for(tmp_path / "short", "stall@1:2"), clock)
        assert read(device, clock) == jpeg(0)
        with pytest.raises(DeviceStalled):
            read(device, clock, within_s=1)
        assert read(device, clock, within_s=2) == jpeg(1)
        options = options_for(tmp_path / "long", "stall@1")
        device = plugin.open(options, clock)
        assert read(device, clock) == jpeg(0)
        with pytest.raises(DeviceStalled):
            read(device, clock, within_s=60)
        device.close()
        assert read(plugin.open(options, clock), clock) == jpeg(1)

    def test_wrong_size_is_corrupt(self, tmp_path: Path, clock: ManualClock) -> None:
        """A picture of another size than the negotiated mode is refused, with both sizes."""
        folder = write_recording(tmp_path / "r", [jpeg(0), jpeg(0, (32, 32))])
        device = plugin.open(UsbMockOptions(recording=folder, pace=0), clock)
        read(device, clock)
        with pytest.raises(FrameCorrupt, match=r"\(32, 32\).*\(64, 48\)"):
            read(device, clock)

    @pytest.mark.parametrize("text", ["drop", "drop@", "drop@-1", "melt@3", "stall@1:x"])
    def test_a_fault_that_cannot_be_read_is_refused(self, text: str) -> None:
        with pytest.raises(ValueError, match=r"fault|float"):
            Fault.parse(text)


class TestPlugging:
    def test_unplug_in_a_frame(self, tmp_path: Path, clock: ManualClock) -> None:
        """Unplugged between two packets of one frame: lost, and half a frame is not delivered."""
        folder = write_recording(tmp_path / "r", 3, size=(640, 480))
        options = UsbMockOptions(recording=folder, pace=0)
        device = plugin.open(options, clock)
        stream = plugin.bench(options).bus
        assert len(jpeg(0, (640, 480))) > 32 * 3072
        read(device, clock)
        plugin.bench(options).sensor.unplug()
        with pytest.raises(DeviceLost, match="unplugged"):
            read(device, clock)
        assert stream.enumerate_devices() is not None

    def test_replugged_at_another_port_is_the_same_sensor(self, tmp_path: Path, clock: ManualClock) -> None:
        """Address and port change, the serial does not, the recording continues, and the old handle stays invalid."""
        options = options_for(tmp_path)
        bench = plugin.bench(options, clock)
        first = plugin.open(options, clock)
        before = (bench.sensor.address, bench.sensor.port)
        assert read(first, clock) == jpeg(0)
        bench.sensor.unplug()
        bench.bus.plug_in(bench.sensor, port=4)
        assert bench.sensor.address != before[0]
        assert bench.sensor.port == 4
        with pytest.raises(DeviceLost):
            read(first, clock)
        first.close()
        second = plugin.open(options, clock)
        assert second.identity == first.identity
        assert read(second, clock) == jpeg(1)

    def test_scripted_unplugging_comes_back(self, tmp_path: Path, clock: ManualClock) -> None:
        """Unplugged for half a second, then found again."""
        options = options_for(tmp_path, "unplug@1:0.5")
        device = plugin.open(options, clock)
        read(device, clock)
        with pytest.raises(DeviceLost):
            read(device, clock)
        device.close()
        with pytest.raises(DeviceNotFound):
            plugin.open(options, clock)
        clock.sleep(0.5)
        assert read(plugin.open(options, clock), clock) == jpeg(1)


class TestPace:
    def test_delivers_at_the_recorded_times(self, tmp_path: Path, clock: ManualClock) -> None:
        """25 fps nominal, 18.75 recorded: eight frames take 8 / 18.75 seconds."""
        device = plugin.open(options_for(tmp_path, pace=1.0), clock)
        start = clock.monotonic_ns()
        for _ in range(8):
            read(device, clock)
        assert (clock.monotonic_ns() - start) / 1e9 == pytest.approx(8 / 18.75, abs=1e-6)

    def test_a_late_reader_gets_no_burst(self, tmp_path: Path, clock: ManualClock) -> None:
        """After a pause of ten seconds one frame is waiting, and the period starts again."""
        device = plugin.open(options_for(tmp_path, pace=1.0), clock)
        read(device, clock)
        clock.sleep(10)
        start = clock.monotonic_ns()
        for _ in range(4):
            read(device, clock)
        assert (clock.monotonic_ns() - start) / 1e9 == pytest.approx(2 / 18.75, abs=1e-6)

    def test_loop(self, tmp_path: Path, clock: ManualClock) -> None:
        """With loop the recording starts over; no frames are an end all the same."""
        device = plugin.open(options_for(tmp_path / "two", frames=2, loop=True), clock)
        assert [read(device, clock) for _ in range(4)] == [jpeg(0), jpeg(1), jpeg(0), jpeg(1)]
        with pytest.raises(RecordingEnded):
            read(plugin.open(options_for(tmp_path / "none", frames=0, loop=True), clock), clock)


def test_two_openings_of_one_sensor_are_busy(tmp_path: Path, clock: ManualClock) -> None:
    """The second one gets an error with the process number; after close it succeeds."""
    options = options_for(tmp_path)
    device = plugin.open(options, clock)
    with pytest.raises(DeviceBusy, match=str(os.getpid())):
        plugin.open(options.model_copy(), clock)
    device.close()
    plugin.open(options, clock).close()


def test_png_frames_are_sent_as_jpeg(tmp_path: Path, clock: ManualClock) -> None:
    """An MJPEG mode has no PNG; numbered copies stay apart on the way."""
    png = jpeg(0, suffix=".png")
    folder = write_recording(tmp_path / "r", [png, with_comment(png, "copy 1"), png])
    device = plugin.open(UsbMockOptions(recording=folder, pace=0), clock)
    frames = [read(device, clock) for _ in range(3)]
    assert all(frame.startswith(b"\xff\xd8") for frame in frames)
    assert b"copy 1" in frames[1]


def test_controls_are_pinned_before_the_stream(tmp_path: Path, clock: ManualClock) -> None:
    """Old and new names reach the camera, automatics first; what cannot be set is reported, not raised."""
    controls = {
        "exposure_absolute": 180,
        "exposure_auto": 1,
        "white_balance_temperature": 4500,
        "gamma": 9000,
        "gain": 70_000,
        "sharpness": -1,
        "zoom": 1,
    }
    options = options_for(tmp_path, controls=controls | {"white_balance_automatic": 0, "brightness": -5})
    device = plugin.open(options, clock)
    values = plugin.bench(options).sensor.controls.values
    assert (values["exposure_time_absolute"], values["auto_exposure"], values["brightness"]) == (180, 1, -5)
    assert values["white_balance_temperature"] == 4500
    unset = getattr(device, "unset_controls")  # noqa: B009
    assert set(unset) == {"gain", "gamma", "sharpness", "zoom"}


def test_an_answer_that_is_too_short_is_a_sensor_that_is_lost(
    tmp_path: Path, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is tried again; any other error would end the gateway."""
    monkeypatch.setattr("plugins.devices.virtual.camera.PROBE_BYTES", 10)
    options = options_for(tmp_path)
    with pytest.raises(DeviceLost, match=r"GelSight Mini .* found 10"):
        plugin.open(options, clock)
    monkeypatch.undo()
    plugin.open(options, clock).close()
