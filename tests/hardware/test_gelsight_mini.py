"""A real GelSight Mini on this machine's bus. Skipped with a message where there is none.

Write the results to firmware_notes/gelsight_mini.md, marked as seen.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from edge.clock import SystemClock
from edge.core.errors import DeviceBusy
from edge.core.imaging.image_bytes import picture_size
from edge.core.imaging.known_profiles import MINI_CONTROLS
from edge.core.ports import Device, DeviceIdentity
from edge.recording.format import Recording, RecordingHeader, RecordingWriter
from plugins.devices.gelsight_mini import GelsightMiniOptions, plugin

pytestmark = pytest.mark.hardware
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def identity() -> DeviceIdentity:
    found = [one.identity for one in plugin.discover(GelsightMiniOptions()) if one.identity]
    if not found:
        pytest.skip("SKIPPED, NOT TESTED: no GelSight Mini is plugged in")
    return found[0]


@pytest.fixture(params=["v4l2", "uvc"])
def options(request: pytest.FixtureRequest, identity: DeviceIdentity) -> GelsightMiniOptions:
    return GelsightMiniOptions(serial=identity.serial, stream=request.param, controls=dict(MINI_CONTROLS))


@pytest.fixture
def device(options: GelsightMiniOptions) -> Iterator[Device]:
    sensor = plugin.open(options, SystemClock())
    yield sensor
    sensor.close()


def test_identity(identity: DeviceIdentity) -> None:
    """Product, serial and the one mode agree with the notes."""
    assert re.fullmatch(r"GelSight Mini R0B [A-Z0-9]{4}-[A-Z0-9]{4}", identity.product)
    assert identity.serial == identity.product[-9:].replace("-", "")
    assert (identity.mode, identity.nominal_fps) == ((3280, 2464), 25.0)


def test_frames_are_new_whole_and_full_size(device: Device) -> None:
    """Sixty consecutive frames, all different, at the rate in the notes."""
    clock = SystemClock()
    frames = [device.read(clock.monotonic_ns() + 5 * SECOND) for _ in range(60)]
    assert len({frame.payload for frame in frames}) == 60
    assert {picture_size(frame.payload) for frame in frames} == {(3280, 2464)}
    fps = 59 * SECOND / (frames[-1].timestamp_ns - frames[0].timestamp_ns)
    print(f"delivered {fps:.2f} fps, {sum(len(frame.payload) for frame in frames) / 60e3:.0f} kB a frame")


def test_controls_are_pinned(device: Device) -> None:
    """Every control of the profile is set and reads back."""
    assert getattr(device, "unset_controls") == {}  # noqa: B009 - not part of the port


def test_one_process_at_a_time(device: Device, options: GelsightMiniOptions) -> None:
    """A second opening is busy."""
    with pytest.raises(DeviceBusy):
        plugin.open(options, SystemClock())


def test_recorded_for_replay(device: Device, tmp_path: Path) -> None:
    """The sensor's frames make a recording that can be played."""
    clock = SystemClock()
    who = device.identity
    with RecordingWriter(
        tmp_path / "r", RecordingHeader(who.product, who.serial, who.mode, who.nominal_fps)
    ) as writer:
        for _ in range(10):
            frame = device.read(clock.monotonic_ns() + 5 * SECOND)
            writer.add(frame.payload, frame.timestamp_ns)
    assert len(Recording.open(tmp_path / "r")) == 10
