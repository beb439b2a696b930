"""What a station costs while nothing presses: a running process's share of one core, on 25 delivered frames a second.

Budget: 15 % of a core without metrics and overview camera. Beside it, of the same frames in the same run: the decoding
of every one of them, and the virtual sensor with its reader alone, which a real sensor's kernel driver replaces.
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from station import gel, jpeg, press_recording, small_bundle, station_config

from edge.acquisition import Acquisition
from edge.clock import SystemClock
from edge.core.imaging.decode import decode_view
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import profile
from edge.recording.format import Recording, RecordingHeader, RecordingWriter
from plugins.devices.usb_mock import UsbMockOptions, plugin

pytestmark = pytest.mark.bench

GELGATE = Path(sys.executable).parent / "gelgate"
FPS, MEASURED_S, WARM_UP_S, FRAMES = 25.0, 60.0, 25.0, 25
# Levels of noise and JPEG quality that give about 1 MB, as USB 2.0 can carry at this rate.
GRAIN, QUALITY = 3, 90
SENSOR = "GelSight Mini R0B TEST-0001"


def stream(folder: Path, size: tuple[int, int]) -> tuple[Path, list[bytes]]:
    """One second of a free gel in that size, to be repeated."""
    rng = np.random.default_rng(0)
    grain = cv2.randn(np.empty((size[1], size[0], 3), np.int16), (0, 0, 0), (GRAIN, GRAIN, GRAIN))
    payloads = [
        larger(jpeg(gel(rng)), size, np.roll(grain, int(rng.integers(size[1])), axis=0))
        for _ in range(FRAMES)
    ]
    with RecordingWriter(folder, RecordingHeader(SENSOR, "TEST0001", size, FPS)) as writer:
        for number, payload in enumerate(payloads):
            writer.add(payload, round(number * 1e9 / FPS))
    return folder, payloads


def nominal(folder: Path, size: tuple[int, int]) -> Path:
    """Presses in that size."""
    found = Recording.open(press_recording(folder / "small", 12))
    with RecordingWriter(folder / "nominal", RecordingHeader(SENSOR, "TEST0001", size, FPS)) as writer:
        for one in found:
            writer.add(larger(one.frame.payload, size), one.frame.timestamp_ns, one.label)
    return folder / "nominal"


def larger(payload: bytes, size: tuple[int, int], grain: NDArray[np.int16] | None = None) -> bytes:
    """The picture in that size. grain: of a camera, int16 (h, w, 3); reading a JPEG costs time by its bytes."""
    picture = cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_COLOR)
    if size == (picture.shape[1], picture.shape[0]):
        return payload
    large = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
    if grain is not None:
        large = cv2.add(large, grain, dtype=cv2.CV_8U)
    return cv2.imencode(".jpg", large, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def share_of_a_core(config: Path) -> float:
    """Of a gateway that runs for some time, without its start."""
    with subprocess.Popen([GELGATE, "run", "-c", config], stdout=subprocess.DEVNULL) as running:
        try:
            time.sleep(WARM_UP_S)
            before_s, start = cpu_s(running.pid), time.perf_counter()
            time.sleep(MEASURED_S)
            return (cpu_s(running.pid) - before_s) / (time.perf_counter() - start)
        finally:
            running.terminate()


def cpu_s(pid: int) -> float:
    """Time on a core of all its threads, in the program and in the kernel (proc(5): fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share_of_the_sensor(recording: Path) -> float:
    """Of the virtual sensor and its reader alone."""
    clock = SystemClock()
    options = UsbMockOptions(recording=recording, pace=1.0, loop=True)
    with Acquisition(lambda: plugin.open(options, clock), clock) as acquisition:
        acquisition.next(10)
        cpu_s, start = time.process_time(), time.perf_counter()
        while time.perf_counter() - start < 10:
            acquisition.next(1)
        return (time.process_time() - cpu_s) / (time.perf_counter() - start)


@pytest.mark.parametrize("name", ["cropped_lr", "mini_lr"])
def test_idle_station(tmp_path: Path, name: str) -> None:
    """320x240, as recordings of other tools have it, and the sensor's own 3280x2464."""
    sensor = profile(name)
    recording, payloads = stream(tmp_path / "idle", sensor.native)
    bundle = small_bundle(tmp_path / "bundle", nominal(tmp_path, sensor.native), sensor)
    config = station_config(tmp_path / "station", recording, bundle, pace=1.0, loop=True)

    station = share_of_a_core(config)
    times_s = []
    for number, payload in enumerate(payloads):
        start = time.process_time()
        decode_view(CameraFrame(payload, 0, number), sensor)
        times_s.append(time.process_time() - start)
    alone = share_of_the_sensor(recording)

    w, h = sensor.native
    print(
        f"\n{w}x{h} at {FPS:g} fps, {sum(map(len, payloads)) / FRAMES / 1e3:.0f} kB a frame, {MEASURED_S:g} s:"
    )
    print(f"station {station:.1%} of a core (budget 15 %), of it virtual sensor and reader {alone:.1%}")
    print(
        f"every frame decoded would be {median(times_s) * FPS:.1%} ({median(times_s) * 1e3:.1f} ms a frame)"
    )
