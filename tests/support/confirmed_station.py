"""A station that has judged a few presses of which people may speak, and its bundle, with the tiny detector."""

import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from command_line import gelgate
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge import registry
from edge.store.acts import CONFIRM, Act
from edge.store.press_store import Store

# The presses lie as they are, with one limit: the choice of another pose and limit is most of the time of a fit.
PLAIN = {"register": "never", "limit": "plain"}
SETTINGS = [word for name, value in PLAIN.items() for word in ("--set", f"{name}={value}")]
OPTIONS = ("--part", "bolt", "--method", "tiny", "--backbone", "tiny", *SETTINGS)


@pytest.fixture(scope="module")
def other_package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The tiny detector and backbone as another distribution installs its own."""
    site = tmp_path_factory.mktemp("site")
    info = site / "other_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other_package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[gelgate.detectors]\ntiny = tiny:TINY\n[gelgate.backbones]\ntiny = tiny:TINY_BACKBONE\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path, str(site)])
        registry._points.cache_clear()
        yield
    registry._points.cache_clear()


def fit(nominal: Path, output: Path, *more: object) -> None:
    made = gelgate("fit", nominal, "-o", output, *OPTIONS, *more)
    assert made.code == 0, made.err


@pytest.fixture(scope="module")
def inspected(tmp_path_factory: pytest.TempPathFactory, other_package: None) -> tuple[Path, list[str]]:
    """A bundle of eight nominal presses, and a station that has judged six, the third and fifth one dented; the folder,
    and the ids of its presses."""
    folder = tmp_path_factory.mktemp("learn")
    nominal = press_recording(folder / "nominal", 8, motion=Motion(hold=8, idle=20), seed=1)
    fit(nominal, folder / "old", "--set", "gain=2.0")
    presses = press_recording(folder / "presses", 6, dented=[2, 4], motion=Motion(hold=8, idle=34), seed=7)
    with SteppedStation(station_config(folder, presses, folder / "old")) as station:
        station.play_presses(6)
        ids = [result.press_id for result in station.results]
        assert station.verdicts == ["pass", "pass", "fail", "pass", "fail", "pass"]
    return folder, ids


@pytest.fixture
def station(inspected: tuple[Path, list[str]], tmp_path: Path) -> tuple[Path, list[str]]:
    """A copy, in which people may say something else."""
    folder, ids = inspected
    for path in folder.glob("gelgate.*"):
        (shutil.copytree if path.is_dir() else shutil.copy)(path, tmp_path / path.name)
    (tmp_path / "gelgate.toml").write_text(
        (folder / "gelgate.toml")
        .read_text()
        .replace('path = "gelgate.db"', f'path = "{tmp_path}/gelgate.db"')
    )
    return tmp_path, ids


def say(folder: Path, words: Mapping[str, str], person: str = "kim") -> None:
    with Store(folder / "gelgate.db") as store:
        for press_id, word in words.items():
            given = {"press_id": press_id, "verdict": word}
            store.begin_act(Act(1, f"{person}, at the page", CONFIRM, None, given, outcome="done"), 0)
