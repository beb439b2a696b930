"""Press images become a recording of presses and lifts."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from small_recordings import PRODUCT, SERIAL, jpeg

from edge.core.errors import DatasetError
from edge.core.imaging.image_bytes import comment, damage
from edge.recording.format import Recording
from edge.recording.from_images import PressLift, images_in, record_images


def make(folder: Path, plan: PressLift, *, suffix: str = ".jpg", presses: int = 2) -> Recording:
    source = folder / "images"
    source.mkdir(parents=True)
    for number in range(presses):
        (source / f"press{number}{suffix}").write_bytes(jpeg(number, suffix=suffix))
    reference = folder / f"free{suffix}"
    reference.write_bytes(jpeg(99, suffix=suffix))
    record_images(folder / "r", images_in(source), reference, plan, product=PRODUCT, serial=SERIAL)
    return Recording.open(folder / "r")


def test_lift_press_lift_press_lift(tmp_path: Path) -> None:
    """Two presses between three lifts, each with its frames; the labels say what is a copy of what."""
    recording = make(tmp_path, PressLift(free_frames=2, press_frames=3))
    states = [frame.label["state"] for frame in recording if frame.label]
    assert states == ["free"] * 2 + ["press"] * 3 + ["free"] * 2 + ["press"] * 3 + ["free"] * 2
    assert recording[2].label == {"state": "press", "press": 0, "source": "press0.jpg", "copy": 0}
    assert recording[9].label == {"state": "press", "press": 1, "source": "press1.jpg", "copy": 2}
    led = make(
        tmp_path / "led", PressLift(lead_frames=4, free_frames=1, press_frames=1)
    )  # to learn the free gel from
    states = [frame.label["state"] for frame in led if frame.label]
    assert states == ["free"] * 5 + ["press", "free", "press", "free"]
    assert led.times_ns()[:3] == [0, 53_333_333, 106_666_667]  # 18.75 frames a second
    assert led.header.nominal_fps == 25.0  # as the sensor advertises


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_bytes_are_untouched(tmp_path: Path, suffix: str) -> None:
    """By default every frame, copies included, has the file's own bytes."""
    recording = make(tmp_path, PressLift(free_frames=1, press_frames=2), suffix=suffix)
    sent = [frame.frame.payload for frame in recording]
    expected = [jpeg(seed, suffix=suffix) for seed in (99, 0, 0, 99, 1, 1, 99)]
    assert sent == expected


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_numbered_copies_differ_in_bytes_alone(tmp_path: Path, suffix: str) -> None:
    """A comment makes copies distinct with the same pixels; originals are unchanged."""
    recording = make(tmp_path, PressLift(free_frames=1, press_frames=3, number_copies=True), suffix=suffix)
    original, first, second = (recording[position].frame.payload for position in (1, 2, 3))
    assert original == jpeg(0, suffix=suffix)
    assert len({original, first, second}) == 3
    assert comment(first) == "gelgate copy, frame 2"
    assert damage(first) is None
    pictures = [
        cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_COLOR) for one in (original, first, second)
    ]
    assert (pictures[0] == pictures[1]).all()
    assert (pictures[0] == pictures[2]).all()


def test_noise_has_its_strength_and_its_seed(tmp_path: Path) -> None:
    """Copies of a grey PNG differ from it by the requested deviation; the same seed gives the same bytes."""
    grey = tmp_path / "grey.png"
    cv2.imwrite(str(grey), np.full((96, 128, 3), 128, np.uint8))
    takes = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        plan = PressLift(press_frames=2, noise_levels=2.0, noise_seed=seed)
        record_images(tmp_path / name, [grey], None, plan, product=PRODUCT, serial=SERIAL)
        takes.append(Recording.open(tmp_path / name)[1].frame.payload)
    assert takes[0] == takes[1] != takes[2]
    noisy = cv2.imdecode(np.frombuffer(takes[0], np.uint8), cv2.IMREAD_COLOR).astype(np.float64)
    # 36,864 values: their deviation is known to 2 / sqrt(2 * 36864) = 0.007; rounding adds 1/12 to the variance.
    assert noisy.std() == pytest.approx(np.sqrt(4 + 1 / 12), abs=0.03)


def test_images_are_taken_in_counting_order(tmp_path: Path) -> None:
    """press10 after press9, folders likewise, other files left out."""
    for name in ("press10.png", "press9.png", "sub2/a.jpg", "sub10/a.jpg", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    names = [path.relative_to(tmp_path).as_posix() for path in images_in(tmp_path)]
    assert names == ["press9.png", "press10.png", "sub2/a.jpg", "sub10/a.jpg"]


def test_every_unfit_image_is_named(tmp_path: Path) -> None:
    """A damaged file and one of another size: one report, both names, and nothing written."""
    (tmp_path / "a.jpg").write_bytes(jpeg(0))
    (tmp_path / "b.jpg").write_bytes(jpeg(1)[:-9])
    (tmp_path / "c.jpg").write_bytes(jpeg(2, (32, 32)))
    with pytest.raises(DatasetError, match=r"2 of 3.*b\.jpg.*c\.jpg \(32x32, not 64x48\)"):
        record_images(tmp_path / "r", images_in(tmp_path), None, PressLift(), product=PRODUCT, serial=SERIAL)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("pattern", ["*.bmp", "**/*"])
def test_no_images_is_refused(tmp_path: Path, pattern: str) -> None:
    """An empty folder, or a pattern that matches nothing, is refused."""
    with pytest.raises(DatasetError, match="no JPEG or PNG"):
        images_in(tmp_path, pattern)


def test_real_presses_play(real_tactile: Path, tmp_path: Path) -> None:
    """Ten ball presses of a real sensor play through the virtual sensor, every frame new."""
    from edge.clock import ManualClock
    from edge.core.errors import RecordingEnded
    from plugins.devices.usb_mock import UsbMockOptions, plugin

    unit = real_tactile / "rpl-cmu__gelslam"
    presses = images_in(unit / "6.310mm", "*/gelsight.png")[:10]
    plan = PressLift(free_frames=3, press_frames=3, number_copies=True)
    count = record_images(
        tmp_path / "r", presses, unit / "background.png", plan, product=PRODUCT, serial=SERIAL
    )
    clock = ManualClock()
    device = plugin.open(UsbMockOptions(recording=tmp_path / "r", pace=0), clock)
    for _ in range(count):
        device.read(clock.monotonic_ns() + 1_000_000_000)
    assert count == 63
    with pytest.raises(RecordingEnded):
        device.read(clock.monotonic_ns() + 1_000_000_000)


def test_a_seed_below_0_is_refused_before_a_frame_is_written() -> None:
    with pytest.raises(ValueError, match="the seed of the noise is 0 or more, found -1"):
        PressLift(noise_levels=1.0, noise_seed=-1)
