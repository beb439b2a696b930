"""What a station takes: every stage of the real path from a frame to a subscriber, beside what this machine can do.

A gateway of this process plays a recording at its own pace and publishes over a broker on this machine. A stage of its
presses notes the times, and runs trunk and flush alone between them, so that a busy machine slows all. A gateway in a
process of its own looks at the free gel of the recording, another one at its presses: processor time, memory, start.
"""

import json
import logging
import os
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from calibration.experiments.tradeoff.floor import Work, floor_ms, see_at_once, trunk_work, work_of
from calibration.experiments.tradeoff.gateway_process import (
    Bare,
    Package,
    Taken,
    listen,
    measure_bare,
    measure_packages,
    measure_sensor,
    time_help,
    watch_gateway,
)
from calibration.experiments.tradeoff.machine import Peak, best, fastest, fingerprint, probe
from edge.clock import SystemClock
from edge.config import Config, load_config
from edge.core.contact.events import PressSettled
from edge.core.contact.press_detector import Look
from edge.core.errors import ConfigError, RecordingError
from edge.core.imaging.frames import CameraFrame
from edge.core.press import Press
from edge.gateway.build import open_station
from edge.logs import Json
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Received
from edge.messaging.sink_worker import SinkWorker
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.session import open_session
from edge.press_stage import Mounted, PressStage
from edge.recording.format import Recording, RecordingWriter
from edge.store.gel_ledger import GelRecord

__all__ = ["STAGES", "Measured", "bench"]

STAGES: Final[Mapping[str, str]] = {
    "look": "a look at a frame: decoded small, contact found",
    "decode": "the settled frame decoded",
    "trunk": "features",
    "head": "score map and score",
    "verdict": "**settled frame to verdict**",
    "transaction": "verdict to outbox: press, count and messages, flushed",
    "outbox": "**settled frame to outbox**",
    "acknowledged": "settled frame to the broker's PUBACK of the result",
    "subscriber": "settled frame to a subscriber of the broker",
    "picture": "settled frame to its picture at the subscriber",
    "bare trunk": "the trunk alone, between the presses",
    "bare flush": "a page of a file flushed to the disk alone, between the presses",
}
"""The rows of the table, each with what it takes."""

REST_TURNS: Final = 3
"""Trunk and flush run alone so many frames after a press is recorded: then its picture has left."""

WAIT_S: Final = 20.0
REPEATS: Final = 30
SMALLEST: Final = cv2.IMREAD_REDUCED_GRAYSCALE_8
"""What reads a JPEG with the least work beside its entropy decoding."""

CONFIG: Final = """\
version = 1
[device]
plugin = "usb_mock"
options = {{ recording = "{recording}", pace = 1.0, loop = true }}
[inspection]
bundle = "{bundle}"
threads = {threads}
[store]
path = "gelgate.db"
[[sinks]]
plugin = "mqtt"
options = {{ host = "{broker.host}", port = {broker.port} }}
"""


@dataclass(frozen=True)
class Measured:
    """What a run gives."""

    bundle: str
    """Its method and trunk."""
    machine: dict[str, Any]
    stages: Mapping[str, Sequence[float]]
    """Milliseconds of each stage of `STAGES`, one for each press, or each frame."""
    floors: Mapping[str, float]
    """The least milliseconds of a stage on this machine."""
    peak: Mapping[str, float]
    """Operations and bytes per second, at most."""
    frame: Mapping[str, float]
    """Of the recording: width, height, mean bytes, frames per second."""
    idle: Taken | None
    """A gateway that looks at the free gel; None where the system does not show it, as for the next."""
    pressing: Taken | None
    """One that judges the recording's presses."""
    bare: Bare | None
    """A process of the same packages and trunk alone."""
    sensor_share: float
    """Of one core, of the simulated sensor that both have."""
    help_s: float
    """`gelgate --help`."""
    packages: Mapping[str, Package]
    """What gelgate needs."""


def bench(judge: Path, recorded: Path, presses: int, idle_s: float, threads: int, folder: Path) -> Measured:
    """Measure a bundle on a recording; the folder, on the disk of the station's database, gets its files.

    presses: with their stages. idle_s: of the gateways in processes of their own. Errors: RecordingError without
    presses or free frames; BundleError; SinkUnavailable without a broker.
    """
    bundle, recording = Bundle.load(judge), Recording.open(recorded)
    if bundle.grid is None or bundle.graphs.trunk is None:
        raise ConfigError(f"'{judge}' is one graph; the floors need a bundle of a trunk and a head")
    machine, before = fingerprint(threads), probe(threads, REPEATS)
    fps = 1e9 / recording.gaps_ns()[0]  # a camera may advertise more
    with LocalBroker() as broker:

        def configure(name: str, played: Path) -> Path:
            path = folder / name / "gelgate.toml"
            path.parent.mkdir()
            paths = {"recording": played.resolve(), "bundle": judge.resolve()}
            path.write_text(CONFIG.format(**paths, threads=threads, broker=broker), encoding="utf-8")
            return path

        free = _copy_free_frames(recording, folder / "free")
        alone: dict[str, Callable[[], object]] = {
            "bare trunk": _open_trunk(bundle, threads),
            "bare flush": partial(_flush, folder),
        }
        stages = _play(load_config(configure("station", recorded)), alone, presses, broker)
        idle = watch_gateway(configure("idle", free), idle_s, broker, fps)
        pressing = watch_gateway(configure("pressing", recorded), idle_s, broker, fps)
    peak = best(before, probe(threads, REPEATS))
    payloads = [
        recording[k].frame.payload for k in range(0, len(recording), max(1, len(recording) // REPEATS))
    ]
    floors = _floors(bundle, peak, payloads, folder)
    width, height = recording.header.mode
    frame = {
        "width": width,
        "height": height,
        "bytes": float(np.mean([len(payload) for payload in payloads])),
    }
    assert bundle.manifest.backbone is not None
    trunk = folder / "trunk.onnx"
    trunk.write_bytes(bundle.graphs.trunk)
    return Measured(
        f"{bundle.manifest.method} on {bundle.manifest.backbone.id}",
        machine,
        stages,
        floors,
        asdict(peak),
        {**frame, "fps": fps},
        idle,
        pressing,
        measure_bare(trunk, see_at_once(bundle), threads),
        measure_sensor(recorded, idle_s),
        time_help(),
        measure_packages(pressing.mapped_bytes if pressing else {}),
    )


class _Watch(PressStage):
    """Notes when a press passes. `acknowledged` and `arrived` may be called by another thread."""

    def __init__(self, alone: Mapping[str, Callable[[], object]]) -> None:
        self.ms: defaultdict[str, list[float]] = defaultdict(list)
        self._alone = alone
        self._taken = self._judged = self._began = 0.0
        self._taken_of: dict[str, float] = {}
        self._turns = 0
        self._arrived: dict[str, dict[str, float]] = {"acknowledged": {}, "result": {}, "heatmap": {}}

    def take(self, frame: CameraFrame) -> None:
        """A frame arrives."""
        self._taken, self._judged = time.perf_counter(), 0.0

    def look(self, look: Look) -> None:
        """The contact has looked at it."""
        if not self._judged and look.level is not None:
            self.ms["look"].append(_since(self._taken))

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        """It has its verdict."""
        self._judged = time.perf_counter()
        if settled is not None and press.verdict is not None:
            self._taken_of[press.press_id] = self._taken
            self.ms["verdict"].append(_since(self._taken))
            for name in ("decode", "trunk", "head"):
                self.ms[name].append(press.latency_ms[name])
        return press

    def record(self, press: Press, gel: GelRecord) -> None:
        """It is in the database, with its messages."""
        if press.press_id in self._taken_of:
            self.ms["outbox"].append(_since(self._taken))
            self.ms["transaction"].append(_since(self._judged))
            self._turns = REST_TURNS

    def turn(self, mounted: Mounted | None) -> None:
        """Run trunk and flush alone, once after each press."""
        self._turns -= 1
        if self._turns == 0:
            for name, run in self._alone.items():
                start = time.perf_counter()
                run()
                self.ms[name].append(_since(start))

    def acknowledged(self, line: logging.LogRecord) -> bool:
        """The broker has taken a message of the station, as the log of its sink says. Returns whether to write it."""
        if line.levelno == logging.DEBUG and line.getMessage().endswith(" result"):
            press = json.loads(Json().format(line))["press_id"]
            self._arrived["acknowledged"].setdefault(press, time.perf_counter())
        return line.levelno > logging.DEBUG

    def arrived(self, message: Received) -> None:
        """A subscriber has a message: a result, or a picture by the id of its press."""
        kind, _, press = message.topic.partition("/gel/v1/")[2].partition("/")
        if kind == "result":
            press = str(message.payload.partition(b'"press_id":')[2].split(b'"')[1], "ascii")
        if kind in self._arrived and message.payload:
            self._arrived[kind].setdefault(press, time.perf_counter())

    def finish(self) -> None:
        """Wait for what is on its way, and take its times."""
        end = time.monotonic() + WAIT_S
        while any(not self._taken_of.keys() <= seen.keys() for seen in self._arrived.values()):
            if time.monotonic() > end:
                break
            time.sleep(0.05)
        kinds = {"acknowledged": "acknowledged", "subscriber": "result", "picture": "heatmap"}
        for name, kind in kinds.items():
            seen = self._arrived[kind]
            self.ms[name] = [
                1e3 * (seen[press] - at) for press, at in self._taken_of.items() if press in seen
            ]


def _since(start: float) -> float:
    return 1e3 * (time.perf_counter() - start)


@contextmanager
def _hear(module: str, heard: Callable[[logging.LogRecord], bool]) -> Iterator[None]:
    """Give each line that a module logs to a function, which says whether it is written."""
    log = logging.getLogger(module)
    level = log.level
    log.addFilter(heard)
    log.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        log.setLevel(level)
        log.removeFilter(heard)


def _open_trunk(bundle: Bundle, threads: int) -> Callable[[], object]:
    """Return what runs the bare trunk once."""
    assert bundle.graphs.trunk is not None
    session = open_session(bundle.graphs.trunk, threads, "the bare trunk")
    picture = np.random.default_rng(0).integers(0, 256, (1, *see_at_once(bundle), 3), np.uint8)
    session.run(None, {"frames": picture})
    return lambda: session.run(None, {"frames": picture})


def _play(
    config: Config, alone: Mapping[str, Callable[[], object]], presses: int, broker: LocalBroker
) -> dict[str, list[float]]:
    watch = _Watch(alone)
    with (
        listen(broker, watch.arrived),
        _hear(SinkWorker.__module__, watch.acknowledged),
        open_station(config, SystemClock(), stages={"bench": watch}) as station,
    ):
        station.run(threading.Event(), presses)
        watch.finish()
    return dict(watch.ms)


def _copy_free_frames(recording: Recording, folder: Path) -> Path:
    """Copy the frames before the first press. Errors: RecordingError where the labels tell of none, or of no press."""
    with RecordingWriter(folder, recording.header) as writer:
        for recorded_frame in recording:
            if recorded_frame.label is None or recorded_frame.label.get("press") is not None:
                break
            writer.add(recorded_frame.frame.payload, recorded_frame.frame.timestamp_ns, recorded_frame.label)
    if not 0 < len(writer) < len(recording):
        raise RecordingError(
            f"'{recording.folder}' does not begin with frames that are labelled as free, with presses after them; give "
            "a recording of `gelgate lab simulate` or one with labels"
        )
    return folder


def _floors(bundle: Bundle, peak: Peak, payloads: Sequence[bytes], folder: Path) -> dict[str, float]:
    """Return the least milliseconds of the stages: entropy decoding, arithmetic or bandwidth, and a flush."""
    assert bundle.graphs.trunk is not None
    whole, trunk = work_of(bundle.graphs.trunk, bundle), trunk_work(bundle.graphs.trunk, bundle)
    head = Work(whole.float32 - trunk.float32, whole.int8 - trunk.int8, whole.bytes - trunk.bytes)
    raw = [np.frombuffer(payload, np.uint8) for payload in payloads]
    decode = float(1e3 * np.median([fastest(partial(cv2.imdecode, jpeg, SMALLEST), 3) for jpeg in raw]))
    floors = {
        "look": decode,
        "decode": decode,
        "trunk": floor_ms(trunk, peak)[0],
        "head": floor_ms(head, peak)[0],
    }
    floors["verdict"] = sum(floors[name] for name in ("decode", "trunk", "head"))
    floors["transaction"] = floors["bare flush"] = 1e3 * fastest(partial(_flush, folder), REPEATS)
    return {**floors, "outbox": floors["verdict"] + floors["transaction"], "bare trunk": floors["trunk"]}


def _flush(folder: Path) -> None:
    """Append a page to a file of the folder, and flush it to the disk."""
    with (folder / "flush").open("ab", buffering=0) as file:
        file.write(bytes(4096))
        os.fdatasync(file.fileno())
