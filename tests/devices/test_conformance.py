"""Every device that plays a recording passes the same checks."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from device_conformance import CHECKS, Bench
from small_recordings import FakeClock, write_recording

from edge.core.ports import Device
from plugins.devices import recorded, usb_mock


class MockBench:
    def __init__(self, folder: Path) -> None:
        self.clock = FakeClock()
        self._folder = folder

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        recording = write_recording(self._folder / "recording", payloads)
        self._options = usb_mock.UsbMockOptions(recording=recording, pace=1.0 if real_time else 0.0)
        return usb_mock.plugin.open(self._options, self.clock)

    def unplug(self) -> None:
        usb_mock.plugin.bench(self._options).unplug()


class RecordedBench:
    def __init__(self, folder: Path) -> None:
        self.clock = FakeClock()
        self._folder = folder / "recording"

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        write_recording(self._folder, payloads)
        options = recorded.RecordedOptions(recording=self._folder, pace=1.0 if real_time else 0.0)
        return recorded.plugin.open(options, self.clock)

    def unplug(self) -> None:
        shutil.rmtree(self._folder)


@pytest.mark.parametrize("bench", [MockBench, RecordedBench])
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_device_conforms(
    bench: type[MockBench] | type[RecordedBench], check: Callable[[Bench], None], tmp_path: Path
) -> None:
    """The check's own docstring states the fact."""
    check(bench(tmp_path))
