"""The device passes the checks of every device. A bench here does what the maker's program does."""

from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path

import pytest

from edge.clock import ManualClock
from edge.core.errors import DeviceNotFound
from plugins.conformance import check_device
from plugins.conformance.device import PERIOD_S, SIZE

from .device import Device, DeviceOptions, plugin


class SavingClock(ManualClock):
    """Calls something whenever time has passed."""

    def __init__(self, passed: Callable[[float], None]) -> None:
        super().__init__()
        self._passed, self._start_ns = passed, self.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        self._passed((self.monotonic_ns() - self._start_ns) / 1e9)


class Camera:
    """A bench: it saves frames at once, or one by one as time passes."""

    def __init__(self, folder: Path) -> None:
        self.clock = SavingClock(self._save)
        self._options = DeviceOptions(folder=folder, size=SIZE)
        self._pending: list[tuple[float, bytes]] = []

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        self._options.folder.mkdir()
        self._pending = [(n * PERIOD_S if real_time else 0.0, payload) for n, payload in enumerate(payloads)]
        self._save(0.0)
        return plugin.open(self._options, self.clock)

    def _save(self, seconds: float) -> None:
        while self._pending and self._pending[0][0] <= seconds:
            number = len(list(self._options.folder.iterdir()))
            (self._options.folder / f"{number:06}.jpg").write_bytes(self._pending.pop(0)[1])

    def unplug(self) -> None:
        self._options.folder.rename(self._options.folder.with_name("gone"))


def test_it_conforms(tmp_path: Path) -> None:
    """`check_device` names every fact that does not hold."""
    numbers = count()
    check_device(lambda: Camera(tmp_path / str(next(numbers))))


def test_it_is_found_while_its_folder_is_there(tmp_path: Path) -> None:
    """By its folder's name, which is its serial."""
    there, gone = DeviceOptions(folder=tmp_path), DeviceOptions(folder=tmp_path / "gone")

    assert [str(device.identity and device.identity.serial) for device in plugin.discover(there)] == [
        tmp_path.name
    ]
    assert plugin.discover(gone) == []
    with pytest.raises(DeviceNotFound, match="gone"):
        plugin.open(gone, ManualClock())
