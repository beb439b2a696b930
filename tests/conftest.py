"""What every test shares: strict arithmetic, and the real frames where they are at hand."""

import gc
import os
import shutil
import signal
import sys
import time
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from chromium import chromium
from hypothesis import settings

from calibration.threads import one_blas_thread

TESTS = Path(__file__).resolve().parent
REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# The marker that tests have by their place. `make test-lab` runs what is `lab`, also single tests elsewhere.
MARKERS = {
    "acquisition": "lab",
    "bench": "bench",
    "docs/test_studies.py": "lab",
    "experiments": "lab",
    "sensor_fit": "lab",
    "simulator/test_interrupt.py": "lab",
    "simulator/test_output.py": "lab",
    "simulator/test_resume.py": "lab",
    "simulator/test_same_bytes.py": "lab",
    "soak": "lab",
    "training": "train",
}

# The same examples in every run, without a limit of time: a run finds what the change before it broke, and not by luck.
# `pytest --hypothesis-profile=default` draws others.
settings.load_profile("ci")

# Folders of tests are in memory, where the system has a place for that with room: a test of a database waits for the
# disk for a third of its time, and none asks what a disk keeps without power.
MEMORY, ROOM = Path("/dev/shm"), 2 << 30
if MEMORY.is_dir() and os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > ROOM:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))

# A shell that starts the tests in the background has them ignore Ctrl-C, and every program that they start with them.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Some set it for small images; each of the hundreds of programs that the tests start would then compile all sources.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


@cache
def find_marker(path: Path) -> str | None:
    """Return the marker that a file's tests have by its place."""
    return next((mark for place, mark in MARKERS.items() if f"{path}/".startswith(f"{TESTS}/{place}/")), None)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import nothing that is not selected."""
    marker = find_marker(collection_path)
    return True if marker and f"not {marker}" in config.option.markexpr else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage among modules and tests, which stay to the end: half of the time of collection."""
    gc.disable()
    done = yield
    gc.freeze()
    gc.enable()
    return done


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests by their place before pytest selects by marker."""
    for item in items:
        if marker := find_marker(item.path):
            item.add_marker(marker)


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """Two threads of linear algebra or of OpenCV spin on cores that other tests use as well."""
    cv2.setNumThreads(1)
    with one_blas_thread():
        yield


@pytest.fixture(autouse=True)
def strict_arithmetic() -> Iterator[None]:
    """Overflow, division by zero and invalid operations raise in every test."""
    with np.errstate(over="raise", divide="raise", invalid="raise"):
        yield


@pytest.fixture(scope="session")
def real_tactile() -> Path:
    """The folder of real tactile frames; the test is skipped, and says so, where it is absent."""
    folder = REAL_DATA / "real_tactile"
    if not folder.is_dir():
        pytest.skip(f"SKIPPED, NOT TESTED: real tactile frames are not at {folder}")
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as opened:
        yield opened


@pytest.fixture
def tokyo(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Local time is nine hours ahead of UTC."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "JST-9")
        time.tzset()
        yield
    time.tzset()
