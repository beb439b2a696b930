"""A working station in a new folder, which is also the working folder; a machine in Tokyo."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import tiny
from breakable_station import Bench
from small_recordings import write_recording


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.chdir(tmp_path)
    made = Bench(tmp_path)
    write_recording(tmp_path / "presses", 4, size=tiny.PROFILE.size)
    made.bundle("bundle")
    return made


@pytest.fixture
def tokyo(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Local time is nine hours ahead of UTC."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "JST-9")
        time.tzset()
        yield
    time.tzset()
