"""Regions that are drawn at the page of a station: a new revision inspects, and what cannot be done says why."""

import hashlib
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from command_line import gelgate
from station import Motion, mark_tried, press_recording, station_config, variant
from stepped_station import SteppedStation

from edge.core.gel_proof import GelProof, Proven
from edge.core.press import Press
from edge.core.registration.pose import Pose
from edge.features import drawn_regions
from edge.features.drawn_regions import MOST_REMEMBERED, DrawnRegionsStage, SetRegionsArguments
from edge.model.bundle import Bundle
from edge.pictures.image_file import texts
from edge.store.gel_proofs import GelBundle, find

DENT = [[4.4, 3.8], [8.6, 3.8], [8.6, 8.1], [4.4, 8.1]]
"""Around the film's dent, and the cells of the map that it reaches; mm."""
SERVED = '[commands]\nunsigned = ["set_regions"]\n'


@contextmanager
def judging(folder: Path, bundle: Path) -> Iterator[SteppedStation]:
    """Four presses, each with the dent; the first one is judged."""
    mine = shutil.copytree(bundle, folder / "bundles" / "pz0")
    presses = press_recording(
        folder / "presses", 4, dented=[0, 1, 2, 3], motion=Motion(hold=8, idle=20), seed=5
    )
    with SteppedStation(station_config(folder / "station", presses, mine, tables=SERVED)) as opened:
        opened.play_presses(1)
        yield opened


@pytest.fixture
def station(tmp_path: Path, bundle: Path) -> Iterator[SteppedStation]:
    with judging(tmp_path, bundle) as opened:
        yield opened


@pytest.fixture(scope="module")
def unchanged(tmp_path_factory: pytest.TempPathFactory, bundle: Path) -> Iterator[SteppedStation]:
    """One for all requests that change nothing."""
    with judging(tmp_path_factory.mktemp("unchanged"), bundle) as opened:
        yield opened


@pytest.fixture(autouse=True)
def without_children(monkeypatch: pytest.MonkeyPatch) -> None:
    start_no_children(monkeypatch)


def start_no_children(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw in this process, and try no bundle: a child takes longer than all the rest of a test."""
    start = subprocess.run

    def run(words: list[Any], **how: Any) -> Any:
        if words[1:2] != ["-m"]:
            return start(words, **how)
        code, out, err = 0, "", ""
        if words[2] == "gelgate":
            done = gelgate(*words[3:])
            code, out, err = done.code, done.out, done.err
        return subprocess.CompletedProcess(words, code, out, err)

    monkeypatch.setattr(subprocess, "run", run)


def draw(station: SteppedStation, **arguments: Any) -> Any:
    """Ask, and have the new bundle opened: the asker's thread, the one that opens, and the loop take their turns."""
    done = station.ask("set_regions", **arguments)
    data = done()
    station.turn()  # the loop asks for the bundles
    station.parts.selection.worker.step()
    station.turn(2)
    return data


def newest(station: SteppedStation) -> str:
    return str(station.results[-1].press_id)


def test_a_region_is_drawn_seen_and_removed(
    station: SteppedStation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next press passes there; the revision before stays beside it byte for byte; without the region it fails."""
    monkeypatch.undo()  # in a child, as at a station
    path = tmp_path / "bundles" / "pz0"
    before = {file.name: file.read_bytes() for file in path.iterdir() if file.is_file()}
    assert station.verdicts == ["fail"]

    data = draw(station, add="logo", points_mm=DENT, press_id=newest(station))

    assert data["regions"] == ["logo"]
    assert re.fullmatch(r"ignored: 1\d\.\d mm2 of 7\d mm2 contact; 1 ignore", data["said"])
    assert {file.name: file.read_bytes() for file in Path(data["kept"]).iterdir() if file.is_file()} == before
    assert station.said("info")["revision"] == data["revision"]
    assert station.said("info")["regions"] == data["said"]
    station.play_presses(2)
    assert station.verdicts == ["fail", "pass"]
    assert station.results[-1].bundle_id == Bundle.load(path).digest

    start_no_children(monkeypatch)
    assert draw(station, remove="logo")["said"] == "no region is drawn any more"
    station.play_presses(3)
    assert station.verdicts == ["fail", "pass", "fail"]
    assert station.said("info")["region_names"] == []


@pytest.mark.parametrize(
    ("proven", "known_from"), [(None, "it was used on gel 1"), (Proven.PRESSES, "it was made on 2025-01-01")]
)
def test_a_drawing_proves_nothing_on_a_gel_and_takes_no_proof_away(
    station: SteppedStation, tmp_path: Path, proven: Proven | None, known_from: str
) -> None:
    """The revision is another bundle by its id, and would be proven as one that is used first."""
    path, store = tmp_path / "bundles" / "pz0", station.parts.store
    change = "UPDATE gel_proofs SET proven = ?, known_from = ?, presses = 7, alarms = 2"
    store.write("a test's proof", lambda connection: connection.execute(change, (proven, known_from)))

    draw(station, add="logo", points_mm=DENT, press_id=newest(station))

    gel = store.read("a gel", lambda it: it.execute("SELECT serial, gel_id FROM gels").fetchone())
    key = GelBundle(*gel, Bundle.load(path).digest)
    assert store.read("a proof", partial(find, key=key)) == GelProof(proven, known_from, 7, 2)


def test_presses_with_a_region_prove_nothing_without_it(station: SteppedStation, tmp_path: Path) -> None:
    """Where nothing was judged, nothing alarmed. What the bundle says of its own gel holds still."""
    path, store = tmp_path / "bundles" / "pz0", station.parts.store
    gel = store.read("a gel", lambda it: it.execute("SELECT serial, gel_id FROM gels").fetchone())
    known = []
    for proven, region in ((Proven.PRESSES, "logo"), (Proven.FIRST_USE, "edge")):
        draw(station, add=region, points_mm=DENT, press_id=newest(station))
        change = "UPDATE gel_proofs SET proven = ?, known_from = 'it was used', presses = 30, alarms = 1"
        store.write("a test's proof", lambda it, given=(change, (proven,)): it.execute(*given))
        draw(station, remove=region)
        key = GelBundle(*gel, Bundle.load(path).digest)
        known.append(store.read("a proof", partial(find, key=key)))
    assert known == [GelProof(None, "it was used"), GelProof(Proven.FIRST_USE, "it was used")]


def test_who_draws_before_the_first_revision_loses_neither(station: SteppedStation, tmp_path: Path) -> None:
    """Both regions are in the third revision, and each revision before stays under its own name."""
    first, press = Bundle.load(tmp_path / "bundles" / "pz0").digest, newest(station)
    wishes = [
        station.ask("set_regions", add=name, points_mm=DENT, press_id=press) for name in ("logo", "seal")
    ]
    done = [wish() for wish in wishes]
    assert [one["regions"] for one in done] == [["logo"], ["logo", "seal"]]
    assert Bundle.load(done[0]["kept"]).digest == first
    assert Bundle.load(done[1]["kept"]).manifest.revision == done[0]["revision"]


def test_nothing_is_drawn_on_a_bundle_put_there_meanwhile(station: SteppedStation, tmp_path: Path) -> None:
    """The press lay as it did for the one that inspects."""
    path = tmp_path / "bundles" / "pz0"
    variant(Path(shutil.copytree(path, tmp_path / "copy")), path, part="PZ9")
    with pytest.raises(ValueError, match="is another one than the one that inspects; reload, and draw again"):
        station.ask("set_regions", add="logo", points_mm=DENT, press_id=newest(station))()
    assert Bundle.load(path).manifest.regions is None


def test_a_defect_says_in_which_region_it_lies(station: SteppedStation) -> None:
    """Judged alone there, it fails as before, and its result names the place."""
    draw(station, add="face", kind="judge", points_mm=DENT, press_id=newest(station))
    station.play_presses(2)
    assert station.verdicts == ["fail", "fail"]
    assert {one.region for one in station.results[0].defects or ()} == {None}
    assert {one.region for one in station.results[1].defects or ()} == {"face"}


def test_the_picture_shows_what_is_ignored(station: SteppedStation, tmp_path: Path) -> None:
    """Its outline on both panels, the place in half its light, and the area in the words of the file."""
    draw(station, add="logo", points_mm=DENT, press_id=newest(station))
    station.play_presses(2)
    station.publish()
    (file,) = (tmp_path / "station" / "out").rglob(f"{newest(station)}*.jpg")
    picture = file.read_bytes()

    assert texts(picture)["drawn"].startswith("ignored: 1")
    sheet = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR).astype(int)
    scale = 448 / 224 * 15.77
    left, top, right, bottom = (round(scale * mm) for mm in (4.4, 3.8, 8.6, 8.1))
    inside, outside = sheet[40 + top + 20 : 40 + bottom - 20, left + 20 : right - 20], sheet[60:100, 20:80]
    assert inside.mean() < 0.7 * outside.mean()
    heat = sheet[40:488, 456:904].mean(axis=2)
    assert heat[top + 20 : bottom - 20, left + 20 : right - 20].max() < 40
    assert heat[top - 2 : top + 3, left + 30 : right - 30].max(axis=0).min() > 90  # the line of its outline


LOGO: dict[str, Any] = {"add": "logo", "points_mm": DENT, "press_id": "newest"}
STRICTER = "gelgate bundle regions .*pz0 NOMINAL -o NEW --add 'stricter seam 1.5 4.400,3.800 "


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({}, "expected either add or remove"),
        ({"add": "logo", "remove": "logo"}, "expected either add or remove"),
        ({"add": "logo", "points_mm": DENT}, "drawn on the picture of a press; name its press_id"),
        (LOGO | {"add": "my logo"}, "add: it has another form than expected"),
        (LOGO | {"points_mm": DENT[:2]}, "region 'logo' has 2 points"),
        (LOGO | {"points_mm": [[1.0]] * 4}, r"points_mm are \[x, y\], in mm"),
        (LOGO | {"points_mm": [DENT[0], DENT[2], DENT[1], DENT[3]]}, "region 'logo' crosses itself"),
        (LOGO | {"points_mm": [[1.0, 1.0], [float("inf"), 1.0], [2.0, 2.0]]}, "finite"),
        (LOGO | {"press_id": "01J0000000000000000000000A"}, "is not among the newest 64"),
        (LOGO | {"add": "seam", "kind": "stricter"}, STRICTER),
        (
            LOGO | {"points_mm": [[0.0, 0.0], [14.2, 0.0], [14.2, 14.2], [0.0, 14.2]]},
            "the regions were not drawn: these regions leave 0.0 mm2",
        ),
        (LOGO | {"points_mm": [[20.0, 2.0], [24.0, 2.0], [24.0, 4.0]]}, "outside the field"),
        ({"remove": "logo"}, "the regions were not drawn: --remove: the bundle has no region 'logo'"),
    ],
)
def test_what_cannot_be_drawn_is_a_sentence_and_the_bundle_stays(
    unchanged: SteppedStation, bundle: Path, arguments: dict[str, Any], sentence: str
) -> None:
    if arguments.get("press_id") == "newest":
        arguments = {**arguments, "press_id": newest(unchanged)}
    with pytest.raises(ValueError, match=sentence):
        unchanged.ask("set_regions", **arguments)()
    path = unchanged.parts.store.path.parents[1] / "bundles" / "pz0"
    assert (path / "manifest.json").read_bytes() == (bundle / "manifest.json").read_bytes()


def test_a_station_of_signed_bundles_draws_none(station: SteppedStation) -> None:
    """It has no key."""
    parts = Mock(selection=station.parts.selection)
    parts.config.inspection.signed = "required"
    stage = DrawnRegionsStage(parts)
    wish = drawn_regions.SetRegionsArguments(remove="logo")
    with pytest.raises(ValueError, match="signed bundles alone, and cannot sign"):
        stage._set(wish)


def test_what_ends_in_the_middle_leaves_the_bundle(
    station: SteppedStation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A child that takes too long, a folder that cannot be written, and a request beside another one."""
    path = tmp_path / "bundles" / "pz0"
    arguments = {"add": "logo", "points_mm": DENT, "press_id": newest(station)}
    ask: Callable[[], Any] = station.ask("set_regions", **arguments)
    first = (path / "manifest.json").read_bytes()

    def late(*words: Any, **how: Any) -> Any:
        with pytest.raises(ValueError, match="another region is being drawn"):
            ask()
        raise subprocess.TimeoutExpired("gelgate", 120)

    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "run", late)
        with pytest.raises(Exception, match="not drawn within 120 s"):
            ask()

    real = Path.rename

    def full(self: Path, target: Path) -> Path:
        if self.name == ".pz0.drawn":
            raise OSError(28, "No space left on device")
        return real(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", full)
        with pytest.raises(Exception, match="cannot be replaced: No space left"):
            ask()
    assert (path / "manifest.json").read_bytes() == first
    assert ask()["regions"] == ["logo"]


KILLED = """
import os, shutil, signal, sys
from pathlib import Path
from edge.features.drawn_regions import _exchange

before, after, old_name, folder = map(Path, sys.argv[1:])

def exchange(place, note):
    for name, whole in (("pz0", before), (".pz0.drawn", after), (old_name, before)):
        shutil.copytree(whole, place / name, copy_function=os.link)
    def trace(frame, event, argument):
        if event == "line":
            note(place)
        return trace
    sys.settrace(trace)
    _exchange(place / "pz0", place / ".pz0.drawn", place / old_name)
    sys.settrace(None)

seen = []
exchange(folder / "first", lambda place: None)  # what runs at the first call alone
exchange(folder / "whole", lambda place: seen.append(sorted((path, path.stat().st_ino) for path in place.rglob("*"))))
for line in (line for line in range(len(seen)) if not line or seen[line] != seen[line - 1]):
    if os.fork() == 0:
        left = line
        def kill(place):
            global left
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
        exchange(folder / str(line), kill)
        os._exit(0)
    assert os.wait()[1] == signal.SIGKILL
"""
"""Exchanges copies of two bundles, each time killed at another line: each before which something has changed."""


def test_a_station_starts_on_what_a_kill_at_any_line_leaves(
    station: SteppedStation, tmp_path: Path, recording: Path
) -> None:
    """One of the two bundles, complete, at the path that it opens; what lies beside it in the folder is left."""
    path = tmp_path / "bundles" / "pz0"
    kept = Path(draw(station, add="logo", points_mm=DENT, press_id=newest(station))["kept"])
    words = [sys.executable, "-c", KILLED, kept, path, kept.name, tmp_path / "killed"]
    subprocess.run(words, check=True, timeout=300)
    states = {_digests(place): place for place in (tmp_path / "killed").iterdir()}
    wanted = {Bundle.load(kept).digest: "fail", Bundle.load(path).digest: "pass"}

    judged = dict[str, str | None]()
    for number, place in enumerate(states.values()):
        folder = tmp_path / f"start{number}"
        config = station_config(folder, recording, f'bundle_folder = "{place}"')
        mark_tried(folder / "gelgate.db", place / "pz0")
        with SteppedStation(config) as started:
            started.play_presses(2)  # the second one has the dent
            judged[started.results[1].bundle_id or ""] = started.verdicts[1]
            assert started.raised == []
    assert judged == wanted


def _digests(place: Path) -> tuple[tuple[str, str], ...]:
    found = sorted(place.glob("*/manifest.json"))
    return tuple((one.parent.name, hashlib.sha256(one.read_bytes()).hexdigest()) for one in found)


def test_presses_are_forgotten_in_turn(station: SteppedStation) -> None:
    stage = station.find(DrawnRegionsStage)
    assert len(stage._seen) == 1
    press = next(iter(stage._seen))
    for number in range(MOST_REMEMBERED):
        stage._seen[f"other {number}"] = stage._seen[press]
    station.play_presses(2)
    assert press not in stage._seen
    assert len(stage._seen) == MOST_REMEMBERED


PRESS_ID = "01ARZ3NDEKTSV4RRFFQ69G5FAV"


def test_corners_on_a_part_that_lay_elsewhere_are_brought_to_the_bank(bundle: Path) -> None:
    """Pixel 10, 20 of the press is pixel 7, 20 of the bank, where the part lay 3 pixels to the right."""
    used = Bundle.load(bundle)
    stage = DrawnRegionsStage(Mock())
    h, w = used.manifest.frame
    placed = Mock(pose=Pose(3.0, 0.0))
    press = Press(score_map=np.zeros((h, w), np.float32), registered=placed, press_id=PRESS_ID)
    stage.keep(press, Mock(bundle=used))
    across, down = used.profile.mm_per_pixel
    arguments = SetRegionsArguments(
        add="hole", points_mm=[[10.5 * across, 20.5 * down]] * 3, press_id=PRESS_ID
    )
    for x, y in stage._find_points(arguments, used):
        assert (x / across, y / down) == pytest.approx((7.5, 20.5))
