"""The checks of the kernel lab, run inside the emulated machine; the last line says PASSED or FAILED."""

import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "tests/support"), str(Path(__file__).parent)]

from power_cut import BUGS, check_power_cuts, find_planted  # noqa: E402
from small_recordings import PRODUCT, SERIAL, jpeg  # noqa: E402
from usbip import UsbIpPort  # noqa: E402

from edge.clock import SystemClock  # noqa: E402
from edge.core.errors import DeviceBusy, DeviceLost, FrameCorrupt  # noqa: E402
from edge.core.imaging.known_profiles import MINI_CONTROLS  # noqa: E402
from edge.core.ports import Device, DeviceIdentity  # noqa: E402
from plugins.devices.gelsight_mini import GelsightMiniOptions, plugin  # noqa: E402
from plugins.devices.v4l2.sensor import video_nodes  # noqa: E402
from plugins.devices.virtual.camera import VirtualCamera  # noqa: E402
from plugins.devices.virtual.descriptors import Board  # noqa: E402

SIZE = (640, 480)
PATIENCE_S = 40
FRAMES = [jpeg(seed, SIZE) for seed in range(4)]
CLOCK = SystemClock()
CAMERA = VirtualCamera(Board(PRODUCT, SERIAL, ((*SIZE, 25.0),)), FRAMES, CLOCK, loop=True)
PORT = UsbIpPort(CAMERA)


def options(stream: str) -> GelsightMiniOptions:
    return GelsightMiniOptions.model_validate({"stream": stream, "controls": dict(MINI_CONTROLS)})


def wait_for(fact: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not fact():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.2)


def has_nodes() -> bool:
    return sorted(node.index for node in video_nodes() if node.serial == SERIAL) == [0, 1]


def read(device: Device) -> bytes:
    """The next complete frame. The first may be cut, because the stream is joined in the middle."""
    while True:
        try:
            return device.read(CLOCK.monotonic_ns() + 10_000_000_000).payload
        except FrameCorrupt as error:
            print("  left out:", error)


def plug_in() -> None:
    """uvcvideo binds to the sensor and makes its two nodes."""
    PORT.attach()
    wait_for(has_nodes)


def sensors() -> list[DeviceIdentity]:
    """The sensors that could be opened."""
    return [one.identity for one in plugin.discover(GelsightMiniOptions()) if one.identity]


def identity() -> None:
    """pyusb reads strings and mode through libusb while uvcvideo is bound."""
    (found,) = sensors()
    assert (found.product, found.serial, found.mode) == (PRODUCT, SERIAL, SIZE)


def stream(path: str) -> None:
    """Controls pinned, twenty frames byte for byte, a second opening busy, the kernel's driver back after close."""
    device = plugin.open(options(path), CLOCK)
    assert getattr(device, "unset_controls") == {}  # noqa: B009 - not part of the port
    assert CAMERA.controls.values["gamma"] == MINI_CONTROLS["gamma"]
    assert all(read(device) in FRAMES for _ in range(20))
    try:
        plugin.open(options("uvc"), CLOCK)
        raise AssertionError("opened twice")
    except DeviceBusy as error:
        print("  second opening:", error)
    device.close()
    wait_for(has_nodes)


def unplug(path: str) -> None:
    """Unplugged while streaming: DeviceLost, no longer found, and usable when it is plugged in again."""
    device = plugin.open(options(path), CLOCK)
    read(device)
    PORT.detach()
    try:
        for _ in range(50):
            read(device)
        raise AssertionError("not lost")
    except DeviceLost as error:
        print("  ", error)
    device.close()
    wait_for(lambda: not sensors())
    plug_in()


def reset() -> None:
    """A reset through libusb leaves the sensor usable."""
    plugin.reset(GelsightMiniOptions())
    wait_for(has_nodes)
    stream("v4l2")


CHECKS: tuple[tuple[str, Callable[[], None]], ...] = (
    ("plug in", plug_in),
    ("identity", identity),
    ("stream through libusb", lambda: stream("uvc")),
    ("stream through V4L2", lambda: stream("v4l2")),
    ("unplug from libusb", lambda: unplug("uvc")),
    ("unplug from V4L2", lambda: unplug("v4l2")),
    ("reset", reset),
    ("power cuts", check_power_cuts),
    ("power cuts without a sync of the database", lambda: find_planted(BUGS[0])),
    ("power cuts without a sync of the file", lambda: find_planted(BUGS[1])),
)


def main() -> None:
    words = " ".join(sys.argv[1:])
    for name, check in CHECKS:
        if not name.startswith(words):
            continue
        start = time.monotonic()
        try:
            check()
        except BaseException:  # noqa: BLE001 - the edge of the lab: whatever it is, it is the result
            traceback.print_exc()
            print(f"KERNEL LAB FAILED at: {name}", flush=True)
            return
        print(f"ok   {name} ({time.monotonic() - start:.1f} s)", flush=True)
    print("KERNEL LAB PASSED", flush=True)


if __name__ == "__main__":
    main()
