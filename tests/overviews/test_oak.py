"""An OAK: quiet before it is imported, a bounded search, and films replayed on the host by depthai itself."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from benches import FILM_SIZE, film

from edge.clock import ManualClock, SystemClock
from edge.core.errors import (
    ConfigError,
    DeviceBusy,
    DeviceLost,
    DeviceNotFound,
    DeviceStalled,
    FrameCorrupt,
    RecordingEnded,
    RecordingError,
)
from edge.core.ports import DeviceIdentity
from edge.extras import is_installed
from plugins.overviews.oak import QUIET, OakCamera, OakOptions, _camera, plugin

IDENTITY = DeviceIdentity("OAK", "14442C10", (320, 240), 5.0)
needs_depthai = pytest.mark.skipif(
    not is_installed("depthai"), reason="SKIPPED, NOT TESTED: the package depthai is not installed"
)

# A module of that name, which writes down what it was imported with and finds no device.
SPY = """
import json, os
print(json.dumps({name: value for name, value in os.environ.items() if name.startswith("DEPTHAI_")}))
class Device:
    getAllAvailableDevices = staticmethod(lambda: [])
"""


def run_with_spy(folder: Path, program: str) -> subprocess.CompletedProcess[str]:
    (folder / "depthai.py").write_text(SPY)
    loud = {"DEPTHAI_TELEMETRY": "1", "DEPTHAI_SEARCH_TIMEOUT": "60000"}
    return subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **loud, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )


def test_everything_that_calls_out_is_off_before_the_import(tmp_path: Path) -> None:
    """Telemetry, crash dumps, feedback, internet checks, also where the shell switched them on; loading the plugin does
    not import it: that costs half a second and 100 MB, and belongs to stations with an OAK alone."""
    done = run_with_spy(
        tmp_path,
        "from edge import registry; plugin = registry.overview('oak'); print('loaded');"
        "assert plugin.discover(plugin.Options()) == []",
    )
    first, imported = done.stdout.splitlines()

    assert (first, json.loads(imported)) == ("loaded", QUIET)
    assert {name for name, value in QUIET.items() if "DISABLE" not in name and value == "0"} == {
        "DEPTHAI_TELEMETRY",
        "DEPTHAI_CRASHDUMP",
        "DEPTHAI_ZOO_INTERNET_CHECK",
        "DEPTHAI_INSTALL_SIGNAL_HANDLER",
    }


# A disk limit that is reached after the import, in a process that it may end.
LIMITED = """
import resource
from pathlib import Path
from plugins.overviews.oak import quiet_depthai
quiet_depthai()
resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))
try:
    Path("grown").write_bytes(bytes(11))
except OSError as error:
    print(error.strerror)
"""


@needs_depthai
def test_a_file_that_may_not_grow_does_not_end_the_process(tmp_path: Path) -> None:
    """With depthai's own signal handlers the gateway would be killed; Python reports an error, which it survives."""
    done = subprocess.run(
        [sys.executable, "-c", LIMITED],
        cwd=tmp_path,
        env={**os.environ, "DEPTHAI_INSTALL_SIGNAL_HANDLER": "1"},
        capture_output=True,
        text=True,
    )

    assert done.stdout.strip().endswith("File too large"), done
    assert done.returncode == 0, done


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence has the command that installs it."""
    monkeypatch.setitem(sys.modules, "depthai", None)

    with pytest.raises(ConfigError, match=r"pip install 'gelgate\[oak\]'"):
        plugin.open(OakOptions(), ManualClock())


@needs_depthai
def test_without_a_device_it_is_refused_at_once() -> None:
    """The search is one look at the buses; opening, which waits for a device, is not tried."""
    with pytest.raises(DeviceNotFound, match="one OAK is expected, seen: none"):
        plugin.open(OakOptions(), SystemClock())


@needs_depthai
def test_a_film_is_replayed_to_its_end(tmp_path: Path) -> None:
    """Its pictures in order, as JPEG; then RecordingEnded. At the end depthai closes its queue: on a busy machine the
    last picture may still lie in it, and is gone."""
    w, h = FILM_SIZE
    options = OakOptions(film=film(tmp_path / "film.mp4"), width=w, height=h, fps=30)
    clock = SystemClock()
    camera = plugin.open(options, clock)
    later_ns = clock.monotonic_ns() + 60 * 10**9
    payloads = [camera.read(later_ns).payload for _ in range(3)]
    with suppress(RecordingEnded):
        payloads.append(camera.read(later_ns).payload)
    with pytest.raises(RecordingEnded, match=f"after {len(payloads)} pictures"):
        camera.read(later_ns)
    camera.close()
    shown = [cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_GRAYSCALE).mean() for one in payloads]

    assert shown == pytest.approx([0, 40, 80, 120][: len(shown)], abs=6)


@needs_depthai
def test_a_film_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no\.mp4 is no file"):
        plugin.open(OakOptions(film=tmp_path / "no.mp4"), SystemClock())


class ScriptedQueue:
    """Answers of depthai's queue; an exception is raised."""

    class QueueException(Exception):
        """Not a RuntimeError, as depthai's."""

    def __init__(self, *answers: object) -> None:
        self.answers, self.waits, self.is_closed = list(answers), list[float](), False

    def get(self, wait: timedelta) -> object:
        self.waits.append(wait.total_seconds())
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        self.is_closed = True


def camera_with(*answers: object) -> tuple[OakCamera, ScriptedQueue]:
    queue = ScriptedQueue(*answers)
    pipeline = SimpleNamespace(stop=lambda: None)
    return OakCamera(IDENTITY, pipeline, queue, ManualClock(), is_film=False), queue


def test_no_picture_by_the_deadline_is_a_stall() -> None:
    """The queue is given exactly the time that is left, and never a negative one."""
    camera, queue = camera_with(None, None)
    for deadline_ns in (1_500_000_000, 0):
        with pytest.raises(DeviceStalled):
            camera.read(deadline_ns)

    assert queue.waits == [0.5, 0.0]
    camera.close()
    assert queue.is_closed  # otherwise the host's thread waits for it for ever
    with pytest.raises(DeviceLost, match="was closed"):
        camera.read(0)


@pytest.mark.parametrize(
    "error", [RuntimeError("Communication exception - X_LINK_ERROR"), ScriptedQueue.QueueException("X_LINK_ERROR")]
)  # fmt: skip
def test_a_lost_link_is_a_lost_camera_for_good(error: Exception) -> None:
    """What XLink raises is mapped, and the queue is not asked again."""
    camera, _ = camera_with(error)

    for _ in range(2):
        with pytest.raises(DeviceLost, match=r"OAK 14442C10 is gone .*X_LINK_ERROR"):
            camera.read(2_000_000_000)


class ScriptedDepthai:
    """A vendor's module with these devices on the bus, of which none starts."""

    def __init__(self, *serials: str) -> None:
        found = [SimpleNamespace(deviceId=serial, name="1.1") for serial in serials]
        self.opened: list[str] = []
        outer = self

        class Device:
            getAllAvailableDevices = staticmethod(lambda: found)

            def __init__(self, info: SimpleNamespace) -> None:
                outer.opened.append(info.deviceId)
                raise RuntimeError("X_LINK_DEVICE_ALREADY_IN_USE")

        self.Device = Device


@pytest.mark.parametrize(
    ("serials", "wanted"), [((), None), (("A", "B"), None), (("A",), "B")], ids=["none", "two", "another"]
)
def test_it_opens_one_device_that_is_there(serials: tuple[str, ...], wanted: str | None) -> None:
    """None, several without a name, or another one: refused with those that are seen, and nothing is opened."""
    dai = ScriptedDepthai(*serials)

    with pytest.raises(DeviceNotFound, match=f"seen: {', '.join(serials) or 'none'};"):
        _camera(dai, OakOptions(serial=wanted), ManualClock())
    assert dai.opened == []


def test_a_device_that_does_not_start_is_busy() -> None:
    """The named one of two is tried, and what it said is in the sentence."""
    dai = ScriptedDepthai("A", "B")

    with pytest.raises(DeviceBusy, match=r"OAK B does not start \(X_LINK_DEVICE_ALREADY_IN_USE"):
        _camera(dai, OakOptions(serial="B"), ManualClock())
    assert dai.opened == ["B"]


def test_a_picture_that_cannot_be_read_is_broken_and_the_next_one_may_be_good() -> None:
    """Any other error would end the gateway, and with it the inspection."""

    def fail() -> None:
        raise RuntimeError("ImgFrame data is smaller than its size")

    good = SimpleNamespace(getCvFrame=lambda: np.zeros((8, 8, 3), np.uint8))
    camera, _ = camera_with(SimpleNamespace(getCvFrame=fail), SimpleNamespace(getCvFrame=lambda: None), good)

    for reason in ("smaller than its size", "frame 1"):
        with pytest.raises(FrameCorrupt, match=reason):
            camera.read(2_000_000_000)
    assert camera.read(2_000_000_000).sequence == 2


def test_a_camera_that_is_gone_may_fail_to_stop() -> None:
    """It is opened again all the same."""

    def fail() -> None:
        raise RuntimeError("X_LINK_ERROR")

    camera, queue = camera_with()
    camera._pipeline.stop = fail
    camera.close()
    assert queue.is_closed


def test_a_search_that_fails_is_tried_again() -> None:
    def fail() -> None:
        raise RuntimeError("cannot search for devices")

    dai = SimpleNamespace(Device=SimpleNamespace(getAllAvailableDevices=fail))
    with pytest.raises(DeviceBusy, match="cannot search for devices"):
        _camera(dai, OakOptions(), ManualClock())
