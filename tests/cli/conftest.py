"""A working station in a new folder, which is also the working folder."""

from pathlib import Path

import pytest
import tiny
from breakable_station import Bench
from real_brokers import mosquitto
from small_recordings import write_recording
from tiny_fit import other_package

from edge.store.press_store import PressRecord, Store
from edge.store.ulid import new_ulid

__all__ = ["mosquitto", "other_package"]

T0 = 1_780_000_000 * 10**9


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.chdir(tmp_path)
    made = Bench(tmp_path)
    write_recording(tmp_path / "presses", 4, size=tiny.PROFILE.size)
    made.bundle("bundle")
    return made


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """A ledger of one sensor with one press."""
    path = tmp_path / "gelgate.db"
    with Store(path) as store:
        press = PressRecord(new_ulid(T0), T0, "2BNN4ZE7", "bolt", "pass")
        store.keep_count(store.record_press(press, lambda gel: []).gel)
    return path
