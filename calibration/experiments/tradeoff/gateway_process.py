"""A gateway in a process of its own: what it takes of a core, of memory and of the disk, and how soon it is ready."""

import json
import math
import os
import re
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Final

from calibration.experiments.tradeoff.machine import read_peak_bytes
from edge import registry
from edge.clock import SystemClock
from edge.core.contact.settings import ContactSettings
from edge.core.errors import DeviceError
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection

__all__ = [
    "Bare",
    "Package",
    "Taken",
    "measure_bare",
    "measure_packages",
    "measure_sensor",
    "time_help",
    "watch_gateway",
]

READY_S: Final = 60.0
HELPS: Final = 5
# An installed program has its modules compiled; where this is set, each start would compile them again.
ENVIRONMENT: Final = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
BARE: Final = """\
import sys, time
start = time.perf_counter()
import cv2, numpy, onnxruntime, paho.mqtt.client, pydantic, sqlite3
imports_s = time.perf_counter() - start
options = onnxruntime.SessionOptions()
options.intra_op_num_threads, options.enable_mem_pattern = int(sys.argv[2]), False
session = onnxruntime.InferenceSession(sys.argv[1], options, providers=["CPUExecutionProvider"])
for _ in range(2):
    session.run(None, {"frames": numpy.zeros((1, int(sys.argv[3]), int(sys.argv[4]), 3), numpy.uint8)})
status = open("/proc/self/status").read()
print(status.partition("VmHWM:")[2].split()[0], imports_s)
"""
"""A program of the packages alone: it runs the trunk of the file that is given, with the threads and frame size."""


@dataclass(frozen=True)
class Taken:
    """What a gateway takes. Shares of one core, and times, are of all its threads."""

    core_share: float
    """After it is ready."""
    memory_bytes: float
    """At its peak."""
    start_s: float
    """From its start to the state `ready`."""
    warm_up_s: float
    """Of that, the frames of the free gel that a reference takes."""
    presses: int
    """Results in the time."""
    press_cpu_ms: float | None
    """Processor time for each of them; None without one."""
    mapped_bytes: Mapping[str, float]
    """Of its packages, by the folder in which they are installed, what is in memory."""


@dataclass(frozen=True)
class Package:
    """One that gelgate needs. Bytes."""

    installed: float
    in_memory: float


@dataclass(frozen=True)
class Bare:
    """The least that a gateway of these packages takes."""

    memory_bytes: float
    """With the trunk, which has run."""
    imports_s: float


def measure_bare(trunk: Path, shape: tuple[int, int], threads: int) -> Bare | None:
    """Measure a process that imports a gateway's packages and runs the trunk, and nothing else; None without /proc.

    shape: rows and columns of what the trunk sees.
    """
    if not Path("/proc/self/status").is_file():
        return None
    words = [sys.executable, "-c", BARE, str(trunk), str(threads), *map(str, shape)]
    kilobytes, imports_s = subprocess.run(
        words, capture_output=True, check=True, env=ENVIRONMENT
    ).stdout.split()
    return Bare(float(int(kilobytes) << 10), float(imports_s))


@contextmanager
def listen(broker: LocalBroker, hear: Callable[[Received], None]) -> Iterator[None]:
    """Give each message of a station at this broker to a function, which another thread calls."""
    address = Broker(broker.host, broker.port, "gelgate-bench", level=broker.level)
    with closing(Connection.open(address, on_received=hear)) as connection:
        connection.subscribe("gelgate/#")
        yield


def watch_gateway(config: Path, seconds: float, broker: LocalBroker, fps: float) -> Taken | None:
    """Run a gateway until it is ready, and then for some time; None without /proc, and where it ends by itself."""
    if not Path("/proc/self/smaps").is_file():
        return None
    ready, results = list[float](), list[float]()

    def note(message: Received) -> None:
        kind = message.topic.partition("/gel/v1/")[2]
        if kind == "state" and message.payload and json.loads(message.payload)["state"] == "ready":
            ready.append(time.perf_counter())
        elif kind == "result":
            results.append(time.perf_counter())

    words = [sys.executable, "-m", "gelgate", "run", "-c", str(config)]
    with listen(broker, note):
        ready.clear()
        start = time.perf_counter()
        with subprocess.Popen(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=ENVIRONMENT
        ) as running:
            try:
                while not ready and running.poll() is None and time.perf_counter() - start < READY_S:
                    time.sleep(0.005)
                if not ready or running.poll() is not None:
                    return None
                before_s, before, from_s = _cpu_s(running.pid), len(results), time.perf_counter()
                time.sleep(seconds)
                cpu_s, presses = _cpu_s(running.pid) - before_s, len(results) - before
                lasted_s = time.perf_counter() - from_s
                settings = ContactSettings()
                return Taken(
                    cpu_s / lasted_s,
                    float(read_peak_bytes(running.pid) or 0),
                    ready[0] - start,
                    (math.ceil(settings.warm_up_s * fps) + settings.baseline_frames - 1) / fps,
                    presses,
                    1e3 * cpu_s / presses if presses else None,
                    _read_mapped(running.pid),
                )
            finally:
                running.terminate()


def measure_sensor(recording: Path, seconds: float) -> float:
    """Measure the share of one core that the simulated sensor takes by itself, at its own pace."""
    plugin, clock = registry.device("usb_mock"), SystemClock()
    options = plugin.Options.model_validate({"recording": recording, "pace": 1.0, "loop": True})
    device = plugin.open(options, clock)
    try:
        start, before_s = time.perf_counter(), time.process_time()
        while time.perf_counter() - start < seconds:
            try:
                device.read(clock.monotonic_ns() + 10**9)
            except DeviceError:
                continue
        return (time.process_time() - before_s) / (time.perf_counter() - start)
    finally:
        device.close()


def time_help() -> float:
    """Return the seconds of `gelgate --help`, the median of some."""
    times = []
    for _ in range(HELPS):
        start = time.perf_counter()
        words = [sys.executable, "-m", "gelgate", "--help"]
        subprocess.run(words, stdout=subprocess.DEVNULL, check=True, env=ENVIRONMENT)
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def measure_packages(mapped_bytes: Mapping[str, float]) -> dict[str, Package]:
    """Return what gelgate needs, the largest first: what each package takes of the disk, and of a gateway's memory."""
    packages = {}
    for name in _list_needed("gelgate"):
        files = [Path(str(file.locate())) for file in distribution(name).files or ()]
        folders = {file.parts[0] for file in distribution(name).files or ()}
        size = sum(file.stat().st_size for file in files if file.is_file())
        packages[name] = Package(float(size), sum(mapped_bytes.get(folder, 0.0) for folder in folders))
    return dict(sorted(packages.items(), key=lambda one: -one[1].installed))


def _list_needed(name: str, known: frozenset[str] = frozenset()) -> set[str]:
    """The distributions that this one needs without its extras, and those that they need; not itself.

    One that is not installed, as where a system's packages give its modules another way, is left out.
    """
    distributions: set[str] = set()
    for requirement in Distribution.from_name(name).requires or ():
        needed = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        if (
            ";" in requirement
            or needed in known | distributions
            or not any(Distribution.discover(name=needed))
        ):
            continue
        distributions |= {needed} | _list_needed(needed, known | distributions)
    return distributions


def _read_mapped(pid: int) -> dict[str, float]:
    """Bytes in memory of the files that are mapped from installed packages, by the folder of the package."""
    bytes_by_folder, folder = Counter[str](), ""
    for line in Path(f"/proc/{pid}/smaps").read_text().splitlines():
        if re.match(r"[0-9a-f]+-[0-9a-f]+ ", line):
            folder = line.partition("/site-packages/")[2].partition("/")[0]
        elif folder and line.startswith("Rss:"):
            bytes_by_folder[folder] += int(line.split()[1]) << 10
    return {name: float(size) for name, size in bytes_by_folder.items()}


def _cpu_s(pid: int) -> float:
    """Time on a core of all its threads, in the program and in the kernel (proc(5): fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
