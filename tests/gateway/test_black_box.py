"""The black box: what a verdict was made from is kept, and the verdict is made again bit for bit."""

import hashlib
import io
import json
import os
import shutil
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from command_line import Outcome
from command_line import gelgate as run
from sql import execute
from station import Configure, station_config, variant
from stepped_station import SteppedStation

from edge.features.black_box import replay
from edge.gateway.recorder import PressReport
from edge.store.acts import CONFIRM, Act
from edge.store.integrity import check_database
from edge.store.press_archive import ArchivedPress, ArchiveFolder, PressArchive, list_presses
from edge.store.ulid import new_ulid


class Played:
    """A station in a folder that was played to its end, and its presses."""

    def __init__(self, folder: Path, reports: list[PressReport]) -> None:
        self.folder, self.reports = folder, reports
        self.config, self.database = folder / "gelgate.toml", folder / "gelgate.db"
        self.archive, self.objects = folder / "gelgate.archive", folder / "gelgate.archive" / "objects"
        self.ids = [report.result.press_id for report in reports]

    def record(self, number: int) -> ArchivedPress:
        (evidence,) = self.row("SELECT evidence FROM presses WHERE press_id = ?", self.ids[number])
        return ArchiveFolder(self.archive).press(self.ids[number], evidence)

    def row(self, query: str, *values: object) -> tuple[bytes, ...]:
        return next(iter(execute(self.database, query, given=values)), ())

    def speak(self, press_id: str) -> None:
        """Let a person at a pedal call the press good."""
        self.row(
            "INSERT INTO acts (time_ns, running_ns, who, verb, arguments, outcome) "
            "VALUES (1, 1, 'pedal', 'confirm_press', ?, 'done')",
            json.dumps({"press_id": press_id, "verdict": "good"}),
        )

    @property
    def pictures(self) -> dict[str, bytes]:
        """The pictures that wait to be published, by press id."""
        query = "SELECT substr(topic, 9), payload FROM outbox WHERE topic LIKE 'heatmap/%'"
        return dict(execute(self.database, query))

    def replay(self, *words: str) -> Outcome:
        return run("station", "replay", *words, "-c", str(self.config))


def play(config: Path) -> tuple[Played, SteppedStation]:
    with SteppedStation(config) as station:
        station.play()
        station.loop.publish_stats()
    return Played(config.parent, station.reports), station


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, recording: Path, bundle: Path) -> Played:
    """Three presses, the second one dented."""
    png = '[station]\nheatmap = "png"'
    return play(station_config(tmp_path_factory.mktemp("station"), recording, bundle, tables=png))[0]


@pytest.fixture
def copy(made: Played, tmp_path: Path) -> Played:
    """The same in another folder, to be damaged."""
    return Played(shutil.copytree(made.folder, tmp_path / "copy"), made.reports)


def test_what_a_verdict_was_made_from_is_kept(made: Played, recording: Path) -> None:
    """The camera's bytes, the free gel, the score map and the machine, each by its SHA-256."""
    archive, press = ArchiveFolder(made.archive), made.record(1)
    machine = json.loads(archive.read(press.machine, "machine"))

    frames = b"".join(path.read_bytes() for path in sorted(recording.rglob("*")) if path.is_file())
    assert archive.read(press.frame, "frame") in frames
    assert len(archive.read(str(press.reference), "free gel")) > 120 * 160 * 3 * 4
    assert len(archive.read(str(press.score_map), "map")) == 4 * np.prod(press.map_shape or ())
    assert (machine["threads"], press.threads) == (2, 2)
    assert {"gelgate", "onnxruntime", "flags", "processor"} <= machine.keys()
    report = made.reports[1]
    assert (press.verdict, press.bundle_id) == ("fail", report.result.bundle_id)
    assert press.serial == report.gel.serial != ""


def test_every_verdict_is_made_again_bit_for_bit(made: Played, tmp_path: Path) -> None:
    """Verdict, score and score map are equal, not close; each picture is the one that was published."""
    done = made.replay("--all", "--picture", str(tmp_path / "all"))
    one = made.replay(made.ids[1][:-1].lower(), "--json", "--picture", str(tmp_path / "one.JPG"))
    found = json.loads(one.out)

    assert (done.code, one.code) == (0, 0), done.err
    assert done.out.count("equal, bit for bit") == 3
    assert [made.replay(number).out[:26] for number in "123"] == made.ids
    assert "3 presses: 3 equal, 0 differ, 0 not made again; 0 others were never archived" in done.out
    assert (tmp_path / "one.JPG").read_bytes().startswith(b"\xff\xd8")
    pictures = {path.stem: path.read_bytes() for path in (tmp_path / "all").iterdir()}
    assert pictures == made.pictures
    assert (found["is_equal"], found["verdict_then"], found["verdict"]) == (True, "fail", "fail")
    assert found["score"] == found["score_then"]
    assert made.replay("--since", "9999-01-01").out.startswith("0 presses")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "give a press id, --all or --since"),
        (["--all", "--since", "8h"], "give a press id, --all or --since"),
        (["01ARZ3NDEKTSV4RRFFQ69G5FAV"], "no press 01ARZ3NDEKTSV4RRFFQ69G5FAV is in database"),
        (["7ZZZZZZZZZZZZZZZZZZZZZZZZZ"], "is it another station's"),
        (["0"], "is the beginning of"),
        (["a%b"], "is no press; give its number"),
        (["77"], "no press 77 is in database"),
        (["--all", "--bundles", "nowhere"], "nowhere does not exist"),
    ],
)
def test_a_wrong_call_is_one_sentence(made: Played, words: list[str], expected: str) -> None:
    done = made.replay(*words)
    assert done.code in (1, 3)
    assert expected in done.sentence()


def put_a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def change(path: Path, old: bytes, new: bytes) -> None:
    path.write_bytes(path.read_bytes().replace(old, new))


@pytest.mark.parametrize(
    ("part", "damage", "words"),
    [
        ("frame", Path.unlink, "the judged frame of press {id} is gone"),
        ("frame", lambda path: change(path, b"\xff\xd9", b"x"), "the judged frame of press {id} is damaged"),
        ("frame", lambda path: change(path, b"\xff\xd9", b"x"), "has another SHA-256 than its name"),
        ("frame", put_a_pipe, "is a named pipe; take the file"),
        ("record", put_a_pipe, "is a named pipe; take the file"),
        (
            "record",
            lambda path: change(path, b'"fail"', b'"pass"'),
            "is not what the ledger says of press {id}",
        ),
    ],
)
def test_what_is_not_as_kept_is_named(
    copy: Played, part: str, damage: Callable[[Path], None], words: str
) -> None:
    """Nothing waits for a pipe, and with several presses the others are made again."""
    frame, record = copy.objects / copy.record(1).frame, copy.archive / f"presses/{copy.ids[1]}.json"
    damage({"frame": frame, "record": record}[part])
    done, every = copy.replay(copy.ids[1]), copy.replay("--all")

    assert (done.code, every.code) == (1, 1)
    assert words.format(id=copy.ids[1]) in done.err
    assert "3 presses: 2 equal, 0 differ, 1 not made again" in every.out


def test_a_press_that_is_kept_no_longer_is_no_fault_and_a_gap_is(copy: Played, tmp_path: Path) -> None:
    """A station that runs for a day keeps its newest presses; that of before may be kept since a person spoke of it."""
    copy.speak(copy.ids[0])
    records = [copy.archive / f"presses/{press_id}.json" for press_id in copy.ids]
    records[1].unlink()
    aged = copy.replay("--all")
    records[2].rename(tmp_path / records[2].name)
    nothing_newer = copy.replay("--all")
    shutil.rmtree(copy.archive)
    empty = copy.replay("--all")

    assert (aged.code, nothing_newer.code, empty.code) == (0, 1, 1)
    assert "2 presses: 2 equal, 0 differ, 0 not made again" in aged.out
    assert "0 others were never archived, 1 are kept no longer" in aged.out
    assert "3 presses: 1 equal, 0 differ, 2 not made again" in nothing_newer.out


def test_where_people_spoke_of_every_press_the_oldest_is_kept_no_longer(copy: Played) -> None:
    """As where a pedal says so of each: what is older than all that is kept is gone for its age."""
    for press_id in copy.ids:
        copy.speak(press_id)
    (copy.archive / f"presses/{copy.ids[0]}.json").unlink()
    done = copy.replay("--all")

    assert done.code == 0
    assert "2 presses: 2 equal, 0 differ, 0 not made again" in done.out
    assert "1 are kept no longer" in done.out


def test_the_evidence_is_in_the_chain(copy: Played) -> None:
    """A row that is given the SHA-256 of another record is a changed press."""
    copy.row("UPDATE presses SET evidence = zeroblob(32) WHERE number = 2")
    (fault,) = (one for one in check_database(copy.database) if one.is_fault)
    assert "press 2 was changed" in fault.text


def test_a_bundle_that_is_gone_is_named(copy: Played, tmp_path: Path, bundle: Path) -> None:
    """With its hash, part and where was looked; --bundles names the folder where old ones are kept. A shadow that had
    judged it is in the configuration as it was."""
    other = variant(bundle, tmp_path / "other", revision=9)
    text = copy.config.read_text(encoding="utf-8").replace(str(bundle), str(other))
    copy.config.write_text(text, encoding="utf-8")
    gone = copy.replay(copy.ids[1])

    assert gone.code == 1
    assert f"the bundle of press {copy.ids[1]} is not there: {copy.record(1).bundle_id} (PZ0/pos1" in gone.err
    assert str(other) in gone.err
    assert copy.replay(copy.ids[1], "--bundles", str(bundle.parent)).code == 0
    shadows = f'[inspection]\nshadows = ["{bundle}"]'
    copy.config.write_text(text.replace("[inspection]", shadows, 1), encoding="utf-8")
    assert copy.replay(copy.ids[1]).code == 0


def test_a_score_that_differs_is_said_with_where_and_why(copy: Played) -> None:
    """The record states another score and map than this machine gives, and another program made it."""
    forge(copy, press := copy.record(1))
    done = copy.replay(press.press_id)

    assert done.code == 8
    for words in (
        "DIFFERS",
        "score map differs at 1 of",
        "most at x 5, y 3 of the region: -0.25",
        "steps of float32",
        "may be why: onnxruntime 1.0.0 then,",
        "may be why: the processor had avx1024",
    ):
        assert words in done.out
    assert "look for faulty memory" not in done.out

    (copy.objects / str(copy.record(1).score_map)).unlink()
    assert "another SHA-256; where it differs cannot be said: " in copy.replay(press.press_id).out


def forge(copy: Played, press: ArchivedPress) -> None:
    """As if another machine had judged this press: one score map pixel, the score, and the fingerprint differ."""

    def put(data: bytes) -> str:
        digest = hashlib.sha256(data).hexdigest()
        (copy.objects / digest).write_bytes(data)
        return digest

    archive = ArchiveFolder(copy.archive)
    score_map = np.frombuffer(archive.read(str(press.score_map), "map"), "<f4").copy()
    score_map.reshape(press.map_shape or ())[3, 5] += 0.25
    machine = json.loads(archive.read(press.machine, "machine"))
    machine["onnxruntime"] = "1.0.0"
    machine["flags"].append("avx1024")
    changes: dict[str, Any] = {
        "score": (press.score or 0) + 0.25,
        "score_map": put(score_map.tobytes()),
        "machine": put(json.dumps(machine).encode()),
    }
    other = press.model_copy(update=changes).encode()
    (copy.archive / "presses" / f"{press.press_id}.json").write_bytes(other)
    evidence = hashlib.sha256(other).digest()
    copy.row("UPDATE presses SET evidence = ? WHERE press_id = ?", evidence, press.press_id)


def test_another_bundle_shows_the_verdicts_that_change(made: Played, tmp_path: Path, bundle: Path) -> None:
    """The same with a limit that nothing reaches: the fail becomes a pass."""
    other = variant(bundle, tmp_path / "lenient", threshold={"value": 1e6})
    done = made.replay("--all", "--bundle", str(other))

    assert done.code == 0, done.err
    changed, *table = done.out.splitlines()
    assert changed.startswith(f"{made.ids[1]}  fail")
    assert "->  pass" in changed
    assert table[0] == "3 presses of this part; verdicts that change: 1"
    assert table[-1].split() == ["pass", "0", "2"]


def test_only_the_newest_presses_are_kept(configure: Configure) -> None:
    """What only older ones used goes with them; their rows stay, and replay says what is gone."""
    played, station = play(configure(tables="[archive]\npresses = 1\n"))

    assert station.raised == []
    assert list_presses(played.archive) == [played.ids[2]]
    assert {path.name for path in played.objects.iterdir()} == set(played.record(2).objects)
    said = played.replay(played.ids[0]).err
    assert f"press {played.ids[0]} is gone" in said
    assert "only the newest presses are kept" in said


def test_the_size_is_kept_as_well(configure: Configure) -> None:
    """With room for one press, the newest one stays."""
    played, _ = play(configure(tables="[archive]\nmb = 1\n"))

    assert 0 < sum(path.stat().st_size for path in played.objects.iterdir()) <= 1_000_000
    assert played.ids[2] in list_presses(played.archive)


def test_a_press_that_is_larger_than_the_archive_is_kept(tmp_path: Path, made: Played) -> None:
    """The newest press stays whatever its size, and takes the place of the one before. What else lies there is looked
    at once, and not with every press."""
    press, archive = made.record(0), PressArchive(tmp_path / "small", 10, 1)
    left = tmp_path / "small" / "objects" / "left"
    for press_id in made.ids[:2]:
        was_left = left.exists()
        archive.keep(press.model_copy(update={"press_id": press_id}), {press.frame: b"frame"})
        assert list_presses(tmp_path / "small") == [press_id]
        assert left.exists() is was_left
        left.touch()


def test_the_newest_presses_are_kept_after_a_clock_set_back(configure: Configure, tmp_path: Path) -> None:
    """The archive that a start finds is read in the order in which presses were made, not in that of their ids."""
    config = configure(tables="[archive]\npresses = 2\n")
    for presses, clock_is_ahead_s in ((2, 60), (1, 0), (1, 0)):
        with SteppedStation(config) as station:
            station.clock.sleep(clock_is_ahead_s)
            station.play_presses(presses)

    ids = [row[0] for row in execute(tmp_path / "gelgate.db", "SELECT press_id FROM presses ORDER BY number")]
    assert max(ids[-2:]) < min(ids[:2])
    assert list_presses(tmp_path / "gelgate.archive") == sorted(ids[-2:])


@pytest.mark.parametrize("most", [{"most_presses": 4}, {"most_bytes": 4 * 100}])
def test_presses_spoken_of_fill_half_the_archive(tmp_path: Path, made: Played, most: dict[str, int]) -> None:
    """Four are kept, by number or by size; of three that people spoke of the oldest goes, and the two others stay. So
    it is after a restart."""
    press = made.record(0).model_copy(update={"reference": None, "score_map": None, "masked": None})
    ids = [new_ulid(number * 10**9, bytes) for number in range(1, 9)]
    kept = []
    for number, press_id in enumerate(ids):
        if number in (0, 6):
            archive = PressArchive(tmp_path / "small", **{"most_presses": 100, "most_bytes": 1 << 20} | most)
            archive.keep_longer(ids[1:3])
        frame = f"{number:064x}"
        one = press.model_copy(update={"press_id": press_id, "frame": frame, "machine": frame})
        archive.keep(one, {frame: bytes(100)})
        if number < 3:
            archive.keep_longer([press_id])
        kept.append([ids.index(name) for name in list_presses(tmp_path / "small")])

    assert kept[3:] == [[0, 1, 2, 3], [1, 2, 3, 4], [1, 2, 4, 5], [1, 2, 5, 6], [1, 2, 6, 7]]


def test_a_press_that_a_person_spoke_of_outlives_the_others(configure: Configure, tmp_path: Path) -> None:
    """The word comes from another process, such as a page."""
    config = configure(tables="[archive]\npresses = 2\n")
    with SteppedStation(config) as station:
        station.play_presses(1)
        given = {"press_id": station.results[0].press_id, "verdict": "good"}
        station.parts.store.begin_act(Act(1, "pedal", CONFIRM, None, given, outcome="done"))
        station.play()
    ids = [one.press_id for one in station.results]

    assert list_presses(tmp_path / "gelgate.archive") == sorted([ids[0], ids[2]])  # of one moment


def test_a_word_of_nothing_stops_no_press(configure: Configure) -> None:
    """A request is recorded before its arguments are checked, and read with the next press."""
    words: list[dict[str, object]] = [{}, {"press_id": None}, {"press_id": ["x"]}, {"press_id": {"a": 1}}]
    outcomes: tuple[Literal["failed"] | None, ...] = (None, "failed")
    with SteppedStation(configure()) as station:
        station.play_presses(1)
        for given, outcome in product(words, outcomes):
            station.parts.store.begin_act(Act(1, "anybody", CONFIRM, None, given, outcome=outcome))
        station.play()

    assert len(station.results) == 3


def small_press(made: Played) -> tuple[ArchivedPress, dict[str, bytes]]:
    """The first press, as if it named a short frame and machine alone; and these, by their digests."""
    frame, machine = (hashlib.sha256(data).hexdigest() for data in (b"frame", b"machine"))
    names = {"frame": frame, "machine": machine, "reference": None, "score_map": None, "masked": None}
    return made.record(0).model_copy(update=names), {frame: b"frame", machine: b"machine"}


@pytest.mark.parametrize("removed", ["objects/*", "presses", ""])
def test_what_was_removed_from_a_running_archive_is_written_again(
    tmp_path: Path, made: Played, removed: str
) -> None:
    """Files or folders, such as to free a disk: what later presses share with earlier ones is there again."""
    archive = PressArchive(tmp_path / "archive", 10, 1 << 20)
    one, objects = small_press(made)
    archive.keep(one, objects)
    for path in (tmp_path / "archive").glob(removed) if removed else [tmp_path / "archive"]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    later = one.model_copy(update={"press_id": made.ids[1]})
    evidence = archive.keep(later, objects)

    kept = ArchiveFolder(tmp_path / "archive")
    assert archive.fault is None
    assert kept.press(made.ids[1], evidence) == later
    assert [kept.read(digest, "object") for digest in objects] == [*objects.values()]


def test_no_object_is_made_of_what_an_archive_holds(tmp_path: Path, made: Played) -> None:
    """A free gel that is no array of numbers would run the code that its writer wants."""
    one, objects = small_press(made)
    np.save(content := io.BytesIO(), np.array([None], object), allow_pickle=True)
    digest = hashlib.sha256(content.getvalue()).hexdigest()
    one = one.model_copy(update={"reference": digest})
    PressArchive(tmp_path, 10, 1 << 20).keep(one, {**objects, digest: content.getvalue()})
    with pytest.raises(ValueError, match="allow_pickle=False"):
        ArchiveFolder(tmp_path).read_reference(one)


@pytest.mark.parametrize("left", [b"", b"mach\0\0\0", b"machine\0", None])
def test_what_a_power_cut_damaged_is_written_again(tmp_path: Path, made: Played, left: bytes | None) -> None:
    """A start finds what presses share short, torn or gone; the next press has it whole, and its size is right."""
    folder, (one, objects) = tmp_path / "archive", small_press(made)
    PressArchive(folder, 10, 1 << 20).keep(one, objects)
    damaged = folder / "objects" / one.machine
    damaged.unlink() if left is None else damaged.write_bytes(left)
    archive = PressArchive(folder, 10, len(b"framemachine"))
    archive.open()
    archive.keep(one.model_copy(update={"press_id": made.ids[1]}), objects)

    kept = ArchiveFolder(folder)
    assert [kept.read(digest, "object") for digest in objects] == [*objects.values()]
    assert list_presses(folder) == sorted(made.ids[:2])  # the two take no more than the room


def test_an_archive_that_is_off_keeps_nothing(configure: Configure) -> None:
    """And a replay says so."""
    played, _ = play(configure(tables="[archive]\npresses = 0\n"))

    assert not played.archive.exists()
    assert "was never archived" in played.replay(played.ids[0]).sentence()


@pytest.mark.parametrize(("store", "alarms"), [("", ["archive"]), ("free_mb = 1e9", ["archive", "disk"])])
def test_an_archive_that_cannot_be_written_stops_no_inspection(
    configure: Configure, tmp_path: Path, store: str, alarms: list[str]
) -> None:
    """A file stands in its place, or there is less room than `store.free_mb`: presses are judged, an alarm says why."""
    config = configure(store=store)
    if not store:
        (tmp_path / "gelgate.archive").write_text("a file in its place", encoding="utf-8")
    played, station = play(config)

    assert station.verdicts == ["pass", "fail", "pass"]
    assert station.raised == alarms
    assert store or "cannot be written" in str(station.alarm("archive"))
    assert not played.archive.is_dir()


def test_a_press_that_the_store_refuses_is_archived_too(config: Path, tmp_path: Path) -> None:
    """Its files follow its row, or the press after it: no press waits for files, and at most one has none."""
    with SteppedStation(config) as station:
        archived = lambda: len(list_presses(tmp_path / "gelgate.archive"))  # noqa: E731
        station.play_presses(1)
        assert archived() == 1
        with station.refusing("presses"):
            station.play_until(lambda: station.has_ended)
            assert archived() == 2
        station.clock.sleep(2)
        station.turn()
        assert archived() == len(station.reports) == 3
    played = Played(tmp_path, station.reports)
    assert [played.record(number).press_id for number in range(3)] == played.ids


def test_what_a_killed_gateway_left_is_removed(copy: Played) -> None:
    """Objects of no press go at the next start; those of a record of a newer version stay."""
    kept = {path.name for path in copy.objects.iterdir()}
    (copy.objects / ("0" * 64)).write_bytes(b"left")
    newer = copy.archive / "presses" / f"{copy.ids[0]}.json"
    newer.write_text(
        newer.read_text(encoding="utf-8").replace('"version":1', '"version":2'), encoding="utf-8"
    )
    play(copy.config)

    after = {path.name for path in copy.objects.iterdir()}
    assert kept <= after
    assert "0" * 64 not in after


def test_what_was_or_is_alone_is_said(made: Played) -> None:
    """A score or a map of one time only, and a map of another size."""
    press, archive = made.record(1), ArchiveFolder(made.archive)
    h, w = press.map_shape or (0, 0)
    now = np.zeros((2, 3), np.float32)
    without = press.model_copy(update={"score_map": None})
    assert replay._of_scores(None, 0.25) == "score None then, 0.25 now"
    assert replay._of_scores(0.25, None) == "score 0.25 then, None now"
    assert replay._of_maps(press, None, archive) == "a score map then alone"
    assert replay._of_maps(without, now, archive) == "a score map now alone"
    assert replay._of_maps(press, now, archive) == f"score map of ({h}, {w}) (h, w) then, (2, 3) now"


def test_a_press_judged_by_the_same_machine_points_to_its_memory(made: Played) -> None:
    """Its program, processor and threads are those of now, and its score is not."""
    (said,) = replay._machine(made.record(1), ArchiveFolder(made.archive))
    assert said.endswith("are as they were: look for faulty memory")
