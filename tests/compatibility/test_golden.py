"""What users get does not change by accident: a station with every optional feature, each method, each verb's help.

`golden/` holds what was written when this was frozen; `make golden` writes it again after a change that is meant, and
the difference is read before it is committed. Bundles in `golden/bundles` are kept as they are while they are there.
"""

import json
import os
import re
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import cv2
import numpy as np
import pytest
from command_line import gelgate
from numpy.typing import NDArray
from scarred_gel import MARK, scarred_recording
from station import Motion, press_recording, small_bundle
from stepped_station import SteppedStation
from toy_trunk import toy_trunk
from typer.main import get_command

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses import preparation
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk
from edge import registry
from edge.cli import build
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.ports import Message
from edge.features.outputs.stage import Outputs
from edge.features.overview import Overview
from edge.features.snapshots import Snapshots
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.pictures.image_file import texts
from plugins.sinks.memory import MemorySink

GOLDEN: Final = Path(__file__).parent / "golden"
IS_WRITING: Final = "GELGATE_GOLDEN" in os.environ

PRESS_ID: Final = r"\b[0-7][0-9A-HJKMNP-TV-Z]{25}\b"
# What differs between two runs or two machines, in the order in which it is replaced.
VOLATILE: Final = (
    (r"\b[0-9a-f]{8}\.\d+\.[0-9a-f]{64}\b", "<head of the ledger>"),
    (r"\b[0-9a-f]{64}\b", "<sha256>"),
    (r"^[0-9a-f]{8}$", "<eight digits>"),
    (r"(PZ0/pos1 )\([0-9a-f]{8}\)", r"\1(<bundle>)"),
    (r"(?<![\d.])" + re.escape(version("gelgate")) + r"(?![\d.])", "<version>"),
)
# Fields that measure this machine; their keys are compared, their values are not.
MEASURED: Final = {
    *("latency_ms", "latency_ms_p50", "latency_ms_max", "disk_free_bytes", "outbox_bytes"),
    *("bytes", "size_bytes", "measured", "cost", "python", "numpy", "onnxruntime"),
}
DECIMAL: Final = re.compile(r"(?<![\d.])\d+\.\d+(?![\d.])")
PNG, JPEG = b"\x89PNG", b"\xff\xd8"
RELATIVE, ABSOLUTE = 1e-4, 1e-5
"""Of numbers from other processors and other releases of onnxruntime and OpenCV."""
REFITTED: Final = 3e-2
"""Of a fit on another processor: banks are rounded to int8, where its last digit may be a whole step."""


# Compare, or write


def check(name: str, found: Any, relative: float = RELATIVE) -> None:
    """Compare with the golden file: JSON by values, text by lines. What is nearly the same is not written again."""
    path = GOLDEN / name
    if path.suffix == ".json":
        found = json.loads(_json(found))
    if IS_WRITING and not (path.exists() and found == _kept(path, relative)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(found if path.suffix == ".txt" else _json(found), encoding="utf-8")
    assert found == _kept(path, relative)


def _kept(path: Path, relative: float) -> Any:
    text = path.read_text(encoding="utf-8")
    return text if path.suffix == ".txt" else _nearly(json.loads(text), relative)


def _json(value: Any) -> str:
    return json.dumps(value, indent=1, ensure_ascii=False) + "\n"


def _nearly(value: Any, relative: float) -> Any:
    """The same, equal to whatever differs from it by the rounding of another machine."""
    if isinstance(value, dict):
        return {key: _nearly(one, relative) for key, one in value.items()}
    if isinstance(value, list):
        return [_nearly(one, relative) for one in value]
    if isinstance(value, str) and DECIMAL.search(value):
        return _Sentence(value, relative)
    return pytest.approx(value, rel=relative, abs=ABSOLUTE) if isinstance(value, float) else value


@dataclass(frozen=True)
class _Sentence:
    """Text in which decimal numbers may differ by the rounding of another machine, of the number or of 1."""

    text: str
    relative: float

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, str) or DECIMAL.split(other) != DECIMAL.split(self.text):
            return False
        mine, others = ([float(number) for number in DECIMAL.findall(text)] for text in (self.text, other))
        return others == pytest.approx(mine, rel=self.relative, abs=self.relative)


def stable(value: Any, instead: Mapping[str, str] = MappingProxyType({})) -> Any:
    """JSON data without what differs between two runs. instead: what stands for texts of this run."""
    if isinstance(value, str):
        for text, other in instead.items():
            value = value.replace(text, other)
        for pattern, other in VOLATILE:
            value = re.sub(pattern, other, value)
        return value
    if isinstance(value, list | tuple):
        return [stable(one, instead) for one in value]
    if isinstance(value, Mapping):
        return {
            stable(key, instead): "<measured>"
            if key in MEASURED and one is not None
            else stable(one, instead)
            for key, one in value.items()
        }
    return value


# A station with every optional feature

CONFIG = """
version = 1
[station]
site = "plant"
stats_s = 5
[device]
plugin = "usb_mock"
options = { recording = "presses", pace = 1 }
[overview]
plugin = "virtual_overview"
codes = ["apriltag"]
parts = { 17 = "PZ0" }
options = { kind = "apriltag", parts = ["17", "17", "17", "17", "18", "17"] }
[inspection]
bundle = "bundle"
press_again = "unsure"
[gel]
unproven = "warn"
limit_presses = 12
[reference]
enforce = "warn"
pieces = [{ name = "M1" }]
[press_again]
missed_defect = 1
false_alarm = 1000
[commands]
unsigned = ["snapshot", "replace_gel", "reference_press"]
[store]
path = "gelgate.db"
[[sinks]]
plugin = "memory"
[[sinks]]
plugin = "jsonl"
options = { folder = "out" }
[[actuators]]
plugin = "virtual_hid"
options = { log = "switched.jsonl" }
outputs = [
  { channel = 1, when = ["pass"] },
  { channel = 2, when = ["fail", "halted"] },
  { channel = 3, when = ["fail"], pulse_ms = 200, deadline_ms = 60000 },
  { channel = 4, when = ["stopped"], safe = true },
]
"""
GIVEN: Final = ("bundle", "gelgate.toml", "nominal", "presses")
SOUND = [[0.02, 0.05], [0.04, 0.01], [0.05, 0.02], [0.01, 0.04], [0.03, 0.03], [0.02, 0.03]]
DAMAGED = {"dent of 0.1 mm": [0.05 * n for n in range(1, 400)]}


class GoldenStation(SteppedStation):
    """Every thread of a station takes its turn after each frame."""

    def turn_all(self) -> None:
        self.find(Overview).camera.step()
        self.play(1)
        for driver in self.find(Outputs).drivers:
            driver.step()
        self.find(Snapshots).worker.step()
        self.publish()

    def turn_until(self, presses: int) -> None:
        """Until this number of presses is recorded, and the gel is free again."""
        while len(self.reports) < presses or self.loop.session.has_contact:
            self.turn_all()

    @property
    def messages(self) -> list[Message]:
        sink = self.parts.publisher._sinks["memory"]
        assert isinstance(sink, MemorySink)
        return sink.messages


@dataclass(frozen=True)
class Played:
    """folder: the station's. answers: of the requests, by verb. messages: in the order in which a receiver got them."""

    folder: Path
    answers: dict[str, dict[str, Any]]
    messages: list[Message]

    @cached_property
    def instead(self) -> dict[str, str]:
        """What stands for the folder, and for the presses, which are numbered."""
        ids = {one for message in self.messages for one in re.findall(PRESS_ID, message.topic)}
        named = {press_id: f"<press {number}>" for number, press_id in enumerate(sorted(ids), 1)}
        return {str(self.folder): "<folder>", **named}


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Twelve presses: sound and damaged ones, a scar, another gel, a master piece, and a part of another kind."""
    folder = tmp_path_factory.mktemp("station")
    bundle = small_bundle(folder / "bundle", press_recording(folder / "nominal", 12, seed=1))
    _know_damage(bundle / "manifest.json")
    scarred_recording(
        folder / "presses", 12, marks={3: [MARK]}, dented=[1, 9], motion=Motion(hold=8, idle=20)
    )
    (folder / "gelgate.toml").write_text(CONFIG, encoding="utf-8")
    answers = {}
    with GoldenStation(folder / "gelgate.toml") as station:
        station.turn_until(2)
        answers["snapshot"] = station.ask("snapshot", before_s=0.5, after_s=0.3)
        station.turn_until(4)
        answers["replace_gel"] = station.ask("replace_gel", gel_id="G2")
        station.turn_until(5)
        answers["reference_press"] = station.ask("reference_press")
        while not station.has_ended:
            station.turn_all()
        station.turn()
        station.loop.publish_stats()
        station.publish()
        messages = station.messages
    return Played(folder, answers, messages)


def _know_damage(manifest: Path) -> None:
    """What a fit states of pieces pressed twice and of damage, so that a second press is asked for."""
    known = json.loads(manifest.read_text(encoding="utf-8"))
    known["facts"]["press_again"] = {"sound": SOUND, "damaged": DAMAGED}
    scores = sorted(score for piece in SOUND for score in piece)
    known["threshold"] |= {"nominal_scores": scores, "pieces": 6, "alpha_floor": 1 / 7}
    manifest.write_text(json.dumps(known), encoding="utf-8")


def test_every_message_of_a_station(played: Played) -> None:
    """By topic, in order; what is sent again unchanged is left out. Of a picture, its size and its texts."""
    topics: dict[str, list[Any]] = {}
    for message in played.messages:
        sent = topics.setdefault(stable(message.topic, played.instead), [])
        one = {"type": message.content_type, "retain": message.retain, "payload": _payload(message)}
        if one["payload"] != (sent[-1]["payload"] if sent else ""):
            sent.append(stable(one, played.instead))

    check("messages.json", {topic: topics[topic] for topic in sorted(topics)})
    check("answers.json", stable(played.answers, played.instead))


def _payload(message: Message) -> Any:
    if message.content_type == "application/json":
        return json.loads(message.payload or b"null")
    if not message.payload.startswith((PNG, JPEG)):
        return message.payload.decode()
    picture = cv2.imdecode(np.frombuffer(message.payload, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return {"shape": list(picture.shape), "texts": texts(message.payload)}


def test_what_a_station_leaves_on_the_disk(played: Played) -> None:
    """The database with its schema and rows, the files, and what the relay board switched."""
    with closing(sqlite3.connect(played.folder / "gelgate.db")) as connection:
        tables = connection.execute(
            "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name"
        ).fetchall()
        rows = {
            name: [[_cell(one) for one in row] for row in connection.execute(f"SELECT * FROM {name}")]
            for name, sql in tables
            if sql.startswith("CREATE TABLE")
        }
    left = (path.relative_to(played.folder) for path in played.folder.rglob("*"))
    files = sorted({stable(str(path), played.instead) for path in left if path.parts[0] not in GIVEN})
    switched = (played.folder / "switched.jsonl").read_text(encoding="utf-8").splitlines()

    check("database.json", stable({"schema": dict(tables), "rows": rows}, played.instead))
    check("files.json", files)
    check("switched.json", stable([json.loads(line) for line in switched], played.instead))


def _cell(value: Any) -> Any:
    if isinstance(value, str) and value.startswith(("{", "[")):
        return json.loads(value)
    return f"<{type(value).__name__}>" if isinstance(value, bytes) else value


@pytest.mark.parametrize(
    "verb",
    ["history", "station acts", "gel show", "station reference chart", "db check", "station replay --all"],
)
def test_what_a_verb_prints_of_the_station(
    played: Played, verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As text, with the local times of one zone."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "JST-9")
        time.tzset()
        done = gelgate(*verb.split(), "--config", played.folder / "gelgate.toml")
    time.tzset()

    check(
        f"printed/{verb.removeprefix('station ').replace(' ', '_')}.txt",
        stable(f"{done.out}{done.err}exit code {done.code}\n", played.instead),
    )


def test_the_help_of_every_verb_and_the_example() -> None:
    """In a terminal of 100 columns."""
    check("example.txt", gelgate("check", "--example").out)
    check("help.txt", "\n".join(_help(get_command(build()), "gelgate")))


def _help(command: Any, path: str) -> Iterator[str]:
    context = command.make_context(
        path, [], resilient_parsing=True, terminal_width=100, max_content_width=100
    )
    yield f"$ {path} --help\n{command.get_help(context)}\n"
    for name in command.list_commands(context) if hasattr(command, "list_commands") else ():
        yield from _help(command.get_command(context, name), f"{path} {name}")


# One bundle per method

SIDE: Final = 64
TAPS: Final = {"layer1": (16, 4), "layer2": (24, 8), "layer3": (32, 16)}


def presses(n: int, seed: int) -> NDArray[np.uint8]:
    """The same blocky part each time, with noise; uint8 (n, 64, 64, 3)."""
    base = np.random.default_rng(0).integers(60, 200, (8, 8, 3)).repeat(8, 0).repeat(8, 1)
    noise = np.random.default_rng(seed).normal(0, 5, (n, SIDE, SIDE, 3))
    return np.clip(base + noise, 0, 255).astype(np.uint8)


def fitted(method: str, folder: Path) -> Path:
    """A bundle of that method with a trunk of a few channels."""
    detector = registry.detector(method)
    taps = {tap: TAPS[tap] for tap in detector.taps(detector.parameters())}
    sensor = SensorProfile("small", (SIDE, SIDE), (0.0, 0.0), (SIDE, SIDE), 1, 15.77)
    config = FitConfig(
        "pin", "top", sensor, Region.full((SIDE, SIDE)), detector, Trunk("toy", toy_trunk(taps))
    )
    names = tuple(f"press {number}" for number in range(10))
    return fit_files(NominalPresses(presses(10, 1), names), config, created="2026-01-01").write(folder)


def maps_of(bundle: Path) -> dict[str, NDArray[np.float32]]:
    """Scores and score maps of a sound and a damaged press."""
    damaged = presses(2, 3)
    damaged[1, 20:30, 20:30] = 255
    scorer = Scorer(Bundle.load(bundle), threads=1)
    scored = [scorer.score(frame) for frame in damaged]
    scores = np.array([one.anomaly_score for one in scored], np.float32)
    return {"scores": scores, "maps": np.stack([one.score_map for one in scored]).astype(np.float32)}


@pytest.mark.parametrize("method", registry.names("detectors"))
def test_scores_and_maps_of_a_method(method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bundle that is kept, of before presses were smoothed, gives the maps that are kept; a fit today that does not
    smooth them gives that manifest and those maps."""
    monkeypatch.setattr(preparation, "smooth_presses", lambda presses: presses)
    kept, maps = GOLDEN / "bundles" / method, GOLDEN / "maps" / f"{method}.npz"
    if IS_WRITING and not kept.exists():
        fitted(method, kept)
    if IS_WRITING:
        maps.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(maps, **maps_of(kept))
    expected, again = np.load(maps), fitted(method, tmp_path / "bundle")

    for bundle, relative in ((kept, 1e-5), (again, REFITTED)):
        for name, found in maps_of(bundle).items():
            most = float(np.abs(expected[name]).max())
            np.testing.assert_allclose(found, expected[name], rtol=relative, atol=relative * most)
    manifest = json.loads((again / "manifest.json").read_text())
    for golden in manifest["golden"]:  # which press scores highest may be another one on another processor
        del golden["score"], golden["map_peaks"]
    check(f"manifests/{method}.json", stable(manifest), REFITTED)
