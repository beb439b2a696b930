"""A dataset whose making was ended: only complete files, and the same bytes in the end."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest
from digests import digests

from calibration.simulator.dataset_writer import simulate_dataset
from calibration.simulator.scene import load_scene
from edge.core.errors import DatasetError

COMMAND = Path(sys.executable).with_name("gelgate")
PRESSES = 8
PATIENCE_S = 300.0  # only what hangs takes so long


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return digests(simulate_dataset(load_scene("small"), tmp_path_factory.mktemp("whole"), presses=PRESSES))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_ended_dataset_continues(how: signal.Signals, whole: dict[str, str], tmp_path: Path) -> None:
    """After SIGINT the exit code is 130, every picture is readable, and no file is partial; after SIGKILL the workers
    end too (they hold its standard error open). The same command then gives the bytes of an uninterrupted run, and
    leaves complete pictures as they are; another seed is refused."""
    cut = ended(how, tmp_path, sum(name.endswith(".png") for name in whole))
    if how is signal.SIGINT:
        assert all(cv2.imread(str(path)) is not None for path in cut.rglob("*.png"))
        assert [path.name for path in cut.rglob(".*")] == []
    before = {path: path.stat().st_mtime_ns for path in cut.rglob("[!.]*.png")}
    assert digests(simulate_dataset(load_scene("small"), cut, presses=PRESSES)) == whole
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert [path.name for path in cut.rglob(".*")] == []
    with pytest.raises(DatasetError, match="seed 0, not 2"):
        simulate_dataset(load_scene("small"), cut, 2, presses=PRESSES)


def ended(how: signal.Signals, folder: Path, complete: int) -> Path:
    """A dataset whose command was ended before it was complete; a busy machine needs several attempts."""
    for attempt in range(10):
        cut = folder / f"cut{attempt}"
        arguments = ["lab", "simulate", "small", "-o", str(cut), "--presses", str(PRESSES), "--workers", "2"]
        process = subprocess.Popen([COMMAND, *arguments], stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + PATIENCE_S
        while process.poll() is None and time.monotonic() < deadline and len(list(cut.rglob("*.png"))) < 6:
            time.sleep(0.02)
        process.send_signal(how)
        _, errors = process.communicate(timeout=PATIENCE_S)
        if len(list(cut.rglob("*.png"))) < complete:
            assert process.returncode == (130 if how is signal.SIGINT else -how), errors
            return cut
    raise AssertionError("it was complete each time, before it could be ended")
