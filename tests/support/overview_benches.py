"""Benches of the built-in overview cameras, for the checks of `plugins.conformance`."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest
from benches import RecordedBench, V4l2Bench

from edge.clock import ManualClock, SystemClock
from edge.core.ports import Device
from edge.extras import is_installed
from plugins.conformance import OverviewBench
from plugins.conformance.device import picture
from plugins.overviews import oak, virtual_overview

__all__ = ["FILM_SIZE", "OVERVIEWS", "film"]

FILM_SIZE = (320, 240)


def film(path: Path, pictures: int = 4) -> Path:
    """An mp4 whose n-th picture is grey of level 40 n."""
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10, FILM_SIZE)
    for number in range(pictures):
        writer.write(np.full((*FILM_SIZE[::-1], 3), 40 * number, np.uint8))
    writer.release()
    return path


class VirtualBench:
    """It draws for ever."""

    def __init__(self) -> None:
        self.clock = ManualClock()

    def open(self) -> Device:
        return virtual_overview.plugin.open(virtual_overview.VirtualOverviewOptions(), self.clock)


class RecordedOverviewBench:
    """The device `recorded`, which serves as an overview camera."""

    def __init__(self, folder: Path) -> None:
        self._device = RecordedBench(folder)
        self.clock = self._device.clock

    def open(self) -> Device:
        return self._device.open([picture(seed) for seed in range(4)])


class UsbCameraBench:
    """The reader of the USB camera behind OpenCV's answers."""

    def __init__(self) -> None:
        self._device = V4l2Bench()
        self.clock = self._device.clock

    def open(self) -> Device:
        return self._device.open([picture(seed) for seed in range(4)])


class OakBench:
    """A pipeline on the host that replays a film: depthai's own nodes and queues, without a device."""

    def __init__(self, folder: Path) -> None:
        self.clock = SystemClock()
        self._film = film(folder / "film.mp4")

    def open(self) -> Device:
        w, h = FILM_SIZE
        return oak.plugin.open(oak.OakOptions(film=self._film, width=w, height=h, fps=30), self.clock)


@contextmanager
def _in_a_folder(make: Callable[[Path], OverviewBench]) -> Iterator[OverviewBench]:
    with tempfile.TemporaryDirectory() as folder:
        yield make(Path(folder))


@contextmanager
def _oak() -> Iterator[OverviewBench]:
    if not is_installed("depthai"):
        pytest.skip("SKIPPED, NOT TESTED: the package depthai is not installed")
    with _in_a_folder(OakBench) as bench:
        yield bench


OVERVIEWS: dict[str, Callable[[], AbstractContextManager[OverviewBench]]] = {
    "oak": _oak,
    "recorded": lambda: _in_a_folder(RecordedOverviewBench),
    "usb_camera": lambda: contextlib.nullcontext(UsbCameraBench()),
    "virtual_overview": lambda: contextlib.nullcontext(VirtualBench()),
}
