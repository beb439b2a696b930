"""The cost of a frame from packets to the consumer; printed, not asserted."""

import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_recordings import write_recording

from edge.acquisition import Acquisition
from edge.clock import SystemClock
from plugins.devices.usb_mock import UsbMockOptions, plugin
from plugins.devices.uvc.payload import FrameAssembler, split_frame

pytestmark = pytest.mark.bench
SIZE = (3280, 2464)


def full_size_jpeg(seed: int) -> bytes:
    """A smooth picture with a little grain, about as large as the sensor's."""
    rng = np.random.default_rng(seed)
    small = rng.normal(120, 40, (20, 26, 3)).clip(0, 255).astype(np.uint8)
    picture = cv2.resize(small, SIZE, interpolation=cv2.INTER_CUBIC).astype(np.float32)
    picture += rng.normal(0, 2.0, picture.shape).astype(np.float32)
    return cv2.imencode(".jpg", picture.clip(0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 80])[
        1
    ].tobytes()


def test_reassembly(capsys: pytest.CaptureFixture[str]) -> None:
    """Milliseconds per full-size frame to join 3072-byte packets, without and with checking."""
    payload = full_size_jpeg(0)
    packets = list(split_frame(payload, fid=0, pts=0, packet_bytes=3072))
    assembler = FrameAssembler()
    taken = []
    for _ in range(50):
        start = time.perf_counter()
        (frame,) = assembler.feed(packets)
        taken.append((time.perf_counter() - start) * 1e3)
    assert frame.payload == payload
    with capsys.disabled():
        print(
            f"\nreassembly of {len(payload) / 1e3:.0f} kB in {len(packets)} packets: median {np.median(taken):.3f} ms"
        )


def test_idle_stream(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Share of one core that an undecoded full-size stream takes at 18.75 fps, virtual camera included."""
    folder = write_recording(tmp_path / "r", [full_size_jpeg(seed) for seed in range(4)], size=SIZE)
    options = UsbMockOptions(recording=folder, loop=True)
    clock = SystemClock()
    with Acquisition(lambda: plugin.open(options, clock), clock) as acquisition:
        acquisition.next(10)
        cpu, wall = time.process_time(), time.perf_counter()
        for _ in range(94):
            assert acquisition.next(10) is not None
        share = (time.process_time() - cpu) / (time.perf_counter() - wall)
        fps = acquisition.status.fps
    with capsys.disabled():
        print(f"\nidle stream 3280x2464 at {fps:.2f} fps: {share * 100:.1f} % of one core")
