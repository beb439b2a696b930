"""A station on recorded presses of a drawn part, for checks: its camera, bundle and time are simulated, all else is
the gateway."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
import onnx.parser

from edge.clock import ManualClock
from edge.config import load_config
from edge.core.arrays import F32
from edge.core.errors import RecordingEnded
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.gateway.build import open_station
from edge.gateway.command_table import ask_stages
from edge.gateway.station_loop import StationLoop
from edge.messaging.result_payload import ResultPayload
from edge.model.bundle import Graphs
from edge.model.bundle_writer import bundle_files, write_bundle
from edge.model.manifest import Facts, Provenance, ThresholdEntry, ToleranceEntry
from edge.model.manifest_facts import GIVEN
from edge.press_stage import Data, PressStage
from edge.recording.format import RecordingHeader, RecordingWriter

__all__ = ["PRESSES", "PlayedStation", "open_played"]

PRESSES: Final = ("pass", "fail", "pass")
"""The verdicts of the presses that the checks play."""

_FPS: Final = 18.75
_SIZE: Final = (320, 240)

# The score of a place is its brightest colour: damage is drawn as a white spot.
_DETECTOR: Final = """<ir_version: 8, opset_import: ["": 17]>
drawn (uint8[n, h, w, 3] frames) => (float[n, h, w] score_map, float[n] score) {
    pixels = Cast <to = 1> (frames)
    score_map = ReduceMax <axes = [3], keepdims = 0> (pixels)
    score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
}"""

_CONFIG: Final = """
version = 1
[device]
plugin = "usb_mock"
options = {{ recording = {recording}, pace = 0 }}
[inspection]
bundle = {bundle}
[store]
path = {database}
[[sinks]]
plugin = "memory"
"""


class PlayedStation:
    """The station, and what has come of the presses so far."""

    def __init__(self, loop: StationLoop, results: Sequence[ResultPayload]) -> None:
        self.loop, self.results = loop, results

    @property
    def raised(self) -> list[str]:
        """The alarms that are raised, in order."""
        return sorted(self.loop.parts.status.view().alarms)

    def ask(self, verb: str, **arguments: Any) -> Data:
        """Do a request at once; returns the data of its response. Errors: GelgateError, ValueError."""
        return ask_stages(self.loop.parts.stages, verb, arguments)

    def play(self) -> None:
        """Let it inspect every press of the recording."""
        acquisition, pause_s = self.loop.parts.acquisition, 0.0
        while True:
            self.loop.parts.clock.sleep(pause_s)
            try:
                pause_s = acquisition.step()
            except RecordingEnded:
                return
            while (frame := acquisition.next(0)) is not None:
                self.loop.step(frame)
            self.loop.parts.pictures.step()


@contextmanager
def open_played(
    folder: Path,
    first: PressStage | None = None,
    tables: str = "",
    presses: Sequence[Literal["pass", "fail"]] = PRESSES,
) -> Iterator[PlayedStation]:
    """Open a station with all features that are installed.

    folder: takes its files; the second time, as after a restart, they are there. first: a stage before the others.
    tables: of its configuration, as TOML. presses: the verdicts of its presses, where no stage changes them.
    """
    files = {name: folder / name for name in ("recording", "bundle", "database")}
    if not files["recording"].exists():
        _record(files["recording"], presses)
        _write_bundle(files["bundle"])
    config = folder / "gelgate.toml"
    config.write_text(
        _CONFIG.format(**{name: json.dumps(str(path)) for name, path in files.items()}) + tables
    )
    results: list[ResultPayload] = []
    opened = open_station(
        load_config(config),
        ManualClock(),
        lambda report: results.append(report.result),
        stages={} if first is None else {"first": first},
    )
    with opened as loop:
        yield PlayedStation(loop, results)


def _record(folder: Path, presses: Sequence[str]) -> None:
    header = RecordingHeader("GelSight Mini R0B CHECK-0001", "CHECK0001", _SIZE, _FPS, profile="cropped_lr")
    with RecordingWriter(folder, header) as writer:
        for number, jpeg in enumerate(_film(tuple(presses))):
            writer.add(jpeg, round(number * 1e9 / _FPS))


@cache
def _film(presses: tuple[str, ...]) -> list[bytes]:
    """Draw the free gel, then one press for each verdict: once for all checks."""
    phases: list[tuple[float, bool]] = [(0.0, False)] * 28
    for verdict in presses:
        is_damaged = verdict == "fail"
        phases += [(depth, is_damaged) for depth in (0.5, *[1.0] * 10, 0.3)] + [(0.0, False)] * 6
    rng, film = np.random.default_rng(0), []
    for depth, is_damaged in phases:
        picture = np.clip(_draw(depth, is_damaged) + rng.normal(0, 2, (*_SIZE[::-1], 3)), 0, 255)
        film.append(cv2.imencode(".jpg", picture.astype(np.uint8))[1].tobytes())
    return film


def _draw(depth: float, is_damaged: bool) -> F32:
    """A frame (h, w, 3): a gel, and a ribbed part pressed into it by `depth`, 0 to 1."""
    y, x = np.mgrid[0 : _SIZE[1], 0 : _SIZE[0]].astype(np.float32)
    ribs = 60 * depth * np.sin(y / 3) * (((x - 160) / 70) ** 2 + ((y - 120) / 80) ** 2 < 1)
    gel = np.stack([120 + 0.1 * y, 130 - 0.05 * x, 110 - 0.1 * y], axis=2)
    picture = gel + ribs[..., None] * np.array([1.0, 0.4, -1.0], np.float32)
    return np.where((is_damaged & (np.hypot(x - 150, y - 100) < 14))[..., None], 200 * depth + 55, picture)


def _write_bundle(folder: Path) -> None:
    sensor = profile("cropped_lr")
    facts = Facts(
        part="drawn",
        position="all",
        method="brightest",
        mode="corrected",
        profile=sensor,
        region=Region.centre(sensor.size),
        threshold=ThresholdEntry(value=240.0, method=GIVEN, alpha=0.05, alpha_floor=1.0, nominal_scores=()),
        tolerance=ToleranceEntry(score=1e-3, score_map=1e-3, relative=1e-4, measured=0.0),
        provenance=Provenance(created="2026-01-01"),
    )
    graph = onnx.parser.parse_model(_DETECTOR).SerializeToString()
    write_bundle(folder, bundle_files(facts, Graphs(detector=graph))[1])
