"""A working station in a new folder, which is also the working folder."""

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
