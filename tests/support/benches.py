"""Benches of the built-in devices, overview cameras and sinks, for the checks of `plugins.conformance`."""

import contextlib
import json
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import pytest
from real_brokers import require

from edge.clock import ManualClock, SystemClock
from edge.core.ports import Device, DeviceIdentity, Message, Sink
from edge.core.sink_context import Station
from edge.extras import is_installed
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from edge.recording.format import RecordingHeader, RecordingWriter
from plugins.conformance import OverviewBench
from plugins.conformance.device import PERIOD_S, SIZE, picture
from plugins.devices import recorded, usb_mock
from plugins.devices.v4l2.sensor import V4l2Sensor
from plugins.overviews import oak, virtual_overview
from plugins.sinks import jsonl, memory, mqtt

BenchT = TypeVar("BenchT")
Make = Callable[[], AbstractContextManager[BenchT]]


class RecordedBench:
    """The device `recorded` on a recording of the payloads; its cable is the folder."""

    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock()
        self._folder = folder / "recording"

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        self._record(payloads)
        options = recorded.RecordedOptions(recording=self._folder, pace=1.0 if real_time else 0.0)
        return recorded.plugin.open(options, self.clock)

    def unplug(self) -> None:
        shutil.rmtree(self._folder)

    def _record(self, payloads: Sequence[bytes]) -> None:
        header = RecordingHeader("GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7", SIZE, 1 / PERIOD_S / 0.75)
        with RecordingWriter(self._folder, header) as writer:
            for position, payload in enumerate(payloads):
                writer.add(payload, round(position * PERIOD_S * 1e9))


class UsbMockBench(RecordedBench):
    """The driver of the real sensor on the virtual bus."""

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        self._record(payloads)
        self._options = usb_mock.UsbMockOptions(recording=self._folder, pace=1.0 if real_time else 0.0)
        return usb_mock.plugin.open(self._options, self.clock)

    def unplug(self) -> None:
        usb_mock.plugin.bench(self._options).sensor.unplug()


class V4l2Bench:
    """The real sensor's reader behind OpenCV's capture, which blocks until it gives up: it knows no deadline."""

    def __init__(self) -> None:
        self.clock, self._is_plugged_in = ManualClock(), True
        self._payloads: list[bytes] = []

    def open(self, payloads: Sequence[bytes], *, real_time: bool = False) -> Device:
        self._payloads = list(payloads)
        identity = DeviceIdentity("GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7", SIZE, 25.0)
        return V4l2Sensor(
            identity, self, self.clock, is_present=lambda: self._is_plugged_in, on_close=lambda: None
        )

    def unplug(self) -> None:
        self._payloads, self._is_plugged_in = [], False

    def read(self) -> tuple[bool, object]:
        """As OpenCV's capture: (whether a frame came, its bytes)."""
        if not self._payloads:
            return False, None
        return True, np.frombuffer(self._payloads.pop(0), np.uint8)[None]

    def release(self) -> None: ...


FILM_SIZE = (320, 240)


def film(path: Path, pictures: int = 4) -> Path:
    """An mp4 whose n-th picture is grey of level 40 n."""
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


class SensorBench:
    """The device of another bench, which serves as an overview camera."""

    def __init__(self, device: "RecordedBench | V4l2Bench") -> None:
        self._device, self.clock = device, device.clock

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


class MemoryBench:
    """The list itself; it is never away and takes everything."""

    def open(self, station: Station) -> Sink:
        self._station = station
        self._sink = memory.plugin.open(memory.MemoryOptions(), station)
        return self._sink

    def received(self, n: int) -> Sequence[tuple[str, bytes]]:
        return [(self._station.topic(one), one.payload) for one in self._sink.messages[:n]]

    def take_away(self) -> bool:
        return False

    def bring_back(self) -> None: ...

    def wait(self) -> None: ...

    def unwanted(self) -> Message | None:
        return None


class JsonlBench:
    """A folder; it is away while a file has its name. It refuses JSON that is none."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "log"

    def open(self, station: Station) -> Sink:
        return jsonl.plugin.open(jsonl.JsonlOptions(folder=self._folder), station)

    def received(self, n: int) -> Sequence[tuple[str, bytes]]:
        lines = (self._folder / "messages.jsonl").read_text(encoding="utf-8").splitlines()[:n]
        return [self._read(json.loads(line)) for line in lines]

    def _read(self, line: dict[str, object]) -> tuple[str, bytes]:
        topic = f"{line['root']}/{line['topic']}"
        if "file" in line:
            return topic, (self._folder / str(line["file"])).read_bytes()
        return topic, json.dumps(line["payload"], separators=(",", ":")).encode()

    def take_away(self) -> bool:
        if self._folder.exists():
            self._folder.rename(self._folder.with_name("away"))
        self._folder.touch()
        return True

    def bring_back(self) -> None:
        self._folder.unlink()

    def wait(self) -> None: ...

    def unwanted(self) -> Message | None:
        return Message("result", b"{")


class MqttBench:
    """mosquitto, with a subscriber to everything; it is away while it does not run, and refuses large messages."""

    def __init__(self, broker: LocalBroker, level: str) -> None:
        self._broker, self._level = broker, level
        self._changed, self._heard = threading.Condition(), list[Received]()
        self._listener = Connection.open(
            Broker(broker.host, broker.port, "listener", level="5", timeout_s=60.0),
            on_received=self._note,  # type: ignore[arg-type]
        )
        self._listener.subscribe("gelgate/#")

    def _note(self, message: Received) -> None:
        with self._changed:
            self._heard.append(message)
            self._changed.notify_all()

    def open(self, station: Station) -> Sink:
        options = {
            "host": self._broker.host,
            "port": self._broker.port,
            "protocol": self._level,
            "retry_s": 1.0,
            "acknowledge_s": 60.0,
        }
        return mqtt.plugin.open(mqtt.MqttOptions.model_validate(options), station)

    def received(self, n: int) -> Sequence[tuple[str, bytes]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._heard) >= n, timeout=60.0)
            return [(one.topic, one.payload) for one in self._heard[:n]]

    def take_away(self) -> bool:
        self._broker.stop()
        return True

    def bring_back(self) -> None:
        self._broker.start()

    def wait(self) -> None:
        time.sleep(0.15)  # 400 times are a minute

    def unwanted(self) -> Message | None:
        return Message("heatmap/1", bytes(10_000), content_type="image/png") if self._level == "5" else None

    def close(self) -> None:
        self._listener.close()


@contextmanager
def in_a_folder(make: Callable[[Path], BenchT]) -> Iterator[BenchT]:
    with tempfile.TemporaryDirectory() as folder:
        yield make(Path(folder))


@contextmanager
def with_mosquitto(level: str) -> Iterator[MqttBench]:
    require("mosquitto")
    with (
        LocalBroker("mosquitto", extra="max_packet_size 2000") as broker,
        contextlib.closing(MqttBench(broker, level)) as bench,
    ):
        yield bench


@contextmanager
def with_oak() -> Iterator[OverviewBench]:
    if not is_installed("depthai"):
        pytest.skip("SKIPPED, NOT TESTED: the package depthai is not installed")
    with in_a_folder(OakBench) as bench:
        yield bench


DEVICES = {"recorded": lambda: in_a_folder(RecordedBench), "usb_mock": lambda: in_a_folder(UsbMockBench)}
SINKS = {
    "memory": lambda: contextlib.nullcontext(MemoryBench()),
    "jsonl": lambda: in_a_folder(JsonlBench),
    "mqtt 5": lambda: with_mosquitto("5"),
    "mqtt 3.1.1": lambda: with_mosquitto("3.1.1"),
}
OVERVIEWS: dict[str, Make[OverviewBench]] = {
    "oak": with_oak,
    "recorded": lambda: in_a_folder(lambda folder: SensorBench(RecordedBench(folder))),
    "usb_camera": lambda: contextlib.nullcontext(SensorBench(V4l2Bench())),
    "virtual_overview": lambda: contextlib.nullcontext(VirtualBench()),
}
