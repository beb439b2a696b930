"""A station that has judged a few presses of which people may speak, and its bundle, with the tiny detector."""

import hashlib
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import gelgate
from sql import execute
from station import Motion, gel, jpeg, press_recording, station_config
from stepped_station import SteppedStation

from calibration.fitting.presses import nominal_presses
from edge.core.arrays import Mask
from edge.core.imaging.region import Region
from edge.store.acts import CONFIRM, Act
from edge.store.press_archive import ArchiveFolder, mask_bytes
from edge.store.press_store import Store

# The presses lie as they are, with one limit: the choice of another pose and limit is most of the time of a fit.
PLAIN = {"register": "never", "limit": "plain"}
SETTINGS = [word for name, value in PLAIN.items() for word in ("--set", f"{name}={value}")]
OPTIONS = ("--part", "bolt", "--method", "tiny", "--backbone", "tiny", *SETTINGS)


_read = nominal_presses._read_recording
_gathered: dict[tuple[str, Region, str], nominal_presses._Gathered] = {}


def fit(nominal: Path, output: Path, *more: object) -> None:
    made = gelgate("fit", nominal, "-o", output, *OPTIONS, *more)
    assert made.code == 0, made.err


@dataclass(frozen=True)
class Judged:
    """A station that has judged six presses, the third and fifth one dented, with a bundle of eight nominal ones."""

    folder: Path
    ids: list[str]
    old: Path
    """The bundle."""
    nominal: Path
    presses: Path
    free: Path
    """A picture of the free gel."""

    @property
    def config(self) -> Path:
        return self.folder / "gelgate.toml"

    @property
    def database(self) -> Path:
        return self.folder / "gelgate.db"

    @property
    def new(self) -> Path:
        """Where another bundle goes."""
        return self.folder / "new"

    def say(self, words: Mapping[int, str], person: str = "kim") -> None:
        """Let somebody speak of presses, by their numbers."""
        with Store(self.database) as store:
            for number, word in words.items():
                given = {"press_id": self.ids[number], "verdict": word}
                store.begin_act(Act(1, f"{person}, at the page", CONFIRM, None, given, outcome="done"))


@pytest.fixture(scope="session")
def inspected_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("learn")


@cache
def _inspect(folder: Path) -> Judged:
    """Fit and play once for every module."""
    nominal = press_recording(folder / "nominal", 8, motion=Motion(free=28, idle=6, hold=8), seed=1)
    fit(nominal, folder / "old", "--set", "gain=2.0")
    presses = press_recording(
        folder / "presses", 6, dented=[2, 4], motion=Motion(free=28, idle=34, hold=8), seed=7
    )
    with SteppedStation(station_config(folder, presses, folder / "old")) as station:
        station.play_presses(6)
        ids = [result.press_id for result in station.results]
        assert station.verdicts == ["pass", "pass", "fail", "pass", "fail", "pass"]
    (free := folder / "free.jpg").write_bytes(jpeg(gel(np.random.default_rng(2), 0.0)))
    return Judged(folder, ids, folder / "old", nominal, presses, free)


@pytest.fixture(scope="module")
def inspected(inspected_folder: Path, other_package: None) -> Iterator[Judged]:
    """Nothing in its folder may change: the recording of its nominal presses is read once, and known from then on."""
    judged = _inspect(inspected_folder)

    def recall(folder: Path, name: str, gathered: nominal_presses._Gathered) -> None:
        if folder != judged.nominal:
            _read(folder, name, gathered)
            return
        key = (repr(gathered.profile), gathered.region, name)
        if key not in _gathered:
            _gathered[key] = nominal_presses._Gathered(gathered.profile, gathered.region)
            _read(folder, name, _gathered[key])
        known = _gathered[key]
        gathered.left_out += [press.name for press in known.presses if press.name in gathered.unwanted]
        gathered.presses += [press for press in known.presses if press.name not in gathered.unwanted]
        gathered.free += known.free[: nominal_presses.MAX_NO_CONTACT - len(gathered.free)]
        gathered.faults += known.faults

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nominal_presses, "_read_recording", recall)
        yield judged


@pytest.fixture
def station(inspected: Judged, tmp_path: Path) -> Judged:
    """People may say something else in it."""
    return copy_station(inspected, tmp_path)


def copy_station(inspected: Judged, folder: Path) -> Judged:
    """Copy the state of a station into a folder."""
    for path in inspected.folder.glob("gelgate.*"):
        (shutil.copytree if path.is_dir() else shutil.copy)(path, folder / path.name)
    text = inspected.config.read_text().replace('path = "gelgate.db"', f'path = "{folder}/gelgate.db"')
    (folder / "gelgate.toml").write_text(text)
    return replace(inspected, folder=folder)


def hide_places(
    station: Judged,
    press_id: str,
    rows: slice = slice(20, 30),
    columns: slice = slice(40, 60),
    shape: tuple[int, int] = (224, 224),
) -> Mask:
    """Archive a press as if scars of the gel had lain under some places of it."""
    folder, scar = station.database.with_suffix(".archive"), np.zeros(shape, np.bool_)
    scar[rows, columns] = True
    ((evidence,),) = execute(station.database, f"SELECT evidence FROM presses WHERE press_id = '{press_id}'")
    data = mask_bytes(scar)
    masked = hashlib.sha256(data).hexdigest()
    press = ArchiveFolder(folder).press(press_id, evidence)
    press = press.model_copy(update={"masked": masked, "map_shape": shape})
    (folder / "objects" / masked).write_bytes(data)
    (folder / "presses" / f"{press_id}.json").write_bytes(press.encode())
    changed = f"UPDATE presses SET evidence = x'{press.sha256().hex()}' WHERE press_id = '{press_id}'"
    execute(station.database, changed)
    return scar
