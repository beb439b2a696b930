"""The black box: what a verdict was made from is kept, and the verdict is made again bit for bit."""

import hashlib
import json
import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from command_line import gelgate as run
from station import station_config
from stepped_station import SteppedStation

from edge.gateway.recorder import PressReport
from edge.store.integrity import check_database
from edge.store.press_archive import ArchivedPress, ArchiveFolder, PressArchive


class Played:
    """A station that was played to its end: its folder and its presses."""

    def __init__(self, config: Path) -> None:
        self.config = config
        self.database = config.parent / "gelgate.db"
        self.archive = config.parent / "gelgate.archive"
        with SteppedStation(config) as station:
            station.play()
            station.loop.publish_stats()
            self.reports: list[PressReport] = station.reports
            self.alarms = station.raised
            self.said = station.parts.publisher.retained_state.all()

    @property
    def ids(self) -> list[str]:
        return [report.result.press_id for report in self.reports]

    def record(self, number: int) -> ArchivedPress:
        press_id = self.ids[number]
        (evidence,) = self.row("SELECT evidence FROM presses WHERE press_id = ?", press_id)
        return ArchiveFolder(self.archive).press(press_id, evidence)

    def row(self, query: str, *values: object) -> tuple[bytes, ...]:
        with closing(sqlite3.connect(self.database)) as connection:
            row: tuple[bytes, ...] = connection.execute(query, values).fetchone()
            return row

    def copied(self, folder: Path) -> "Played":
        """The same in another folder, to be damaged."""
        copy = object.__new__(Played)
        shutil.copytree(self.config.parent, folder)
        copy.config, copy.reports = folder / "gelgate.toml", self.reports
        copy.database, copy.archive = folder / "gelgate.db", folder / "gelgate.archive"
        return copy


def more(config: Path, text: str) -> Path:
    """The configuration with another table."""
    config.write_text(config.read_text(encoding="utf-8") + text, encoding="utf-8")
    return config


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, recording: Path, bundle: Path) -> Played:
    """Three presses, the second one dented."""
    return Played(station_config(tmp_path_factory.mktemp("station"), recording, bundle))


def test_what_a_verdict_was_made_from_is_kept(made: Played, recording: Path) -> None:
    """The camera's bytes, the free gel, the score map and the machine, each by its SHA-256."""
    archive, press = ArchiveFolder(made.archive), made.record(1)
    frame = archive.read(press.frame, "frame")
    machine = json.loads(archive.read(press.machine, "machine"))

    assert frame in b"".join(path.read_bytes() for path in sorted(recording.rglob("*")) if path.is_file())
    assert press.reference is not None
    assert len(archive.read(press.reference, "free gel")) > 120 * 160 * 3 * 4
    assert press.map_shape is not None
    assert len(archive.read(str(press.score_map), "map")) == 4 * np.prod(press.map_shape)
    assert (machine["threads"], press.threads) == (2, 2)
    assert {"gelgate", "onnxruntime", "flags", "processor"} <= machine.keys()
    assert (press.verdict, press.bundle_id) == ("fail", made.reports[1].result.bundle_id)


def test_every_verdict_is_made_again_bit_for_bit(made: Played) -> None:
    """Verdict, score and score map are equal, not close."""
    done = run("station", "replay", "--all", "-c", str(made.config))

    assert done.code == 0, done.err
    assert done.out.count("equal, bit for bit") == 3
    assert "3 presses: 3 equal, 0 differ, 0 not made again; 0 others were never archived" in done.out


def test_one_press_is_found_by_the_beginning_of_its_id(made: Played) -> None:
    """In small letters too."""
    press_id = made.ids[1]
    done = run("station", "replay", press_id[:-1].lower(), "-c", str(made.config))

    assert done.code == 0, done.err
    assert done.out.startswith(f"{press_id}  ")
    assert "PZ0/pos1  fail" in done.out


def test_the_picture_is_made_again(made: Played, tmp_path: Path) -> None:
    """It is the one that was published."""
    done = run(
        "station", "replay", made.ids[1], "-c", str(made.config), "--picture", str(tmp_path / "press.png")
    )

    assert done.code == 0, done.err
    assert (tmp_path / "press.png").read_bytes() == made.reports[1].heatmap_png
    run("station", "replay", "--all", "-c", str(made.config), "--picture", str(tmp_path / "all"))
    assert sorted(path.stem for path in (tmp_path / "all").iterdir()) == sorted(made.ids)


def test_since_selects_by_time(made: Played) -> None:
    """Nothing is from the future."""
    done = run("station", "replay", "--since", "9999-01-01", "-c", str(made.config))

    assert done.code == 0
    assert done.out.startswith("0 presses")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "give a press id, --all or --since"),
        (["--all", "--since", "8h"], "give a press id, --all or --since"),
        (["01ARZ3NDEKTSV4RRFFQ69G5FAV"], "no press 01ARZ3NDEKTSV4RRFFQ69G5FAV is in database"),
        (["0"], "is the beginning of"),
        (["a%b"], "is no press id"),
        (["--all", "--bundles", "nowhere"], "nowhere does not exist"),
    ],
)
def test_a_wrong_call_is_one_sentence(made: Played, words: list[str], expected: str) -> None:
    """The thing, what was found, what to do."""
    done = run("station", "replay", *words, "-c", str(made.config))

    assert done.code in (1, 3)
    assert expected in done.err
    assert done.err.count("\n") == 1


def test_a_press_of_another_station_is_said_to_be_unknown(made: Played) -> None:
    """With the ledger and the presses of the database that was asked."""
    done = run("station", "replay", "7ZZZZZZZZZZZZZZZZZZZZZZZZZ", "-c", str(made.config))

    (ledger_id,) = made.row("SELECT ledger_id FROM ledger_start")
    assert (
        f"(ledger {ledger_id}, 3 presses, {min(made.ids)} to {max(made.ids)}); is it of another station"
        in done.err
    )


def test_a_frame_that_is_gone_is_named(made: Played, tmp_path: Path) -> None:
    """And with several presses the others are made again."""
    copy = made.copied(tmp_path / "copy")
    (copy.archive / "objects" / made.record(1).frame).unlink()
    one = run("station", "replay", made.ids[1], "-c", str(copy.config))
    every = run("station", "replay", "--all", "-c", str(copy.config))

    assert one.code == 1
    assert f"the judged frame of press {made.ids[1]} is gone" in one.err
    assert every.code == 1
    assert "3 presses: 2 equal, 0 differ, 1 not made again" in every.out


def test_a_damaged_file_of_the_archive_is_named(made: Played, tmp_path: Path) -> None:
    """One bit is enough."""
    copy = made.copied(tmp_path / "copy")
    frame = copy.archive / "objects" / made.record(1).frame
    frame.write_bytes(frame.read_bytes()[:-1] + b"x")
    done = run("station", "replay", made.ids[1], "-c", str(copy.config))

    assert done.code == 1
    assert f"the judged frame of press {made.ids[1]} is damaged" in done.err
    assert "has another SHA-256 than its name" in done.err


@pytest.mark.parametrize("folder", ["objects", "presses"])
def test_a_named_pipe_in_the_archive_is_not_waited_for(made: Played, tmp_path: Path, folder: str) -> None:
    """It is named, by `replay`; a gateway that opens the archive does not hang either."""
    copy = made.copied(tmp_path / "copy")
    name = made.record(1).frame if folder == "objects" else f"{made.ids[1]}.json"
    (copy.archive / folder / name).unlink()
    os.mkfifo(copy.archive / folder / name)
    done = run("station", "replay", made.ids[1], "-c", str(copy.config))

    assert done.code == 1
    assert f"{name} is a named pipe; take the file from a backup" in done.err
    assert (made.ids[1] in ArchiveFolder(copy.archive).press_ids()) == (folder == "objects")


def test_a_record_that_was_exchanged_is_not_what_the_ledger_says(made: Played, tmp_path: Path) -> None:
    """Neither a changed record nor that of another press is taken."""
    copy = made.copied(tmp_path / "copy")
    record = copy.archive / "presses" / f"{made.ids[1]}.json"
    record.write_text(record.read_text(encoding="utf-8").replace('"fail"', '"pass"'), encoding="utf-8")
    done = run("station", "replay", made.ids[1], "-c", str(copy.config))

    assert done.code == 1
    assert f"is not what the ledger says of press {made.ids[1]}" in done.err


def test_the_evidence_is_in_the_chain(made: Played, tmp_path: Path) -> None:
    """A row that is given the SHA-256 of another record is a changed press."""
    copy = made.copied(tmp_path / "copy")
    with closing(sqlite3.connect(copy.database)) as connection, connection:
        connection.execute("UPDATE presses SET evidence = zeroblob(32) WHERE number = 2")

    assert ["press 2 was changed" in one.text for one in check_database(copy.database) if one.is_fault] == [
        True
    ]


def test_a_bundle_that_is_gone_is_named(made: Played, tmp_path: Path, bundle: Path) -> None:
    """With its hash, part and where was looked; --bundles names the folder where old ones are kept."""
    copy = made.copied(tmp_path / "copy")
    other = tmp_path / "other"
    shutil.copytree(bundle, other)
    manifest = other / "manifest.json"
    manifest.write_text(manifest.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    text = copy.config.read_text(encoding="utf-8").replace(str(bundle), str(other))
    copy.config.write_text(text, encoding="utf-8")
    gone = run("station", "replay", made.ids[1], "-c", str(copy.config))
    found = run("station", "replay", made.ids[1], "-c", str(copy.config), "--bundles", str(bundle.parent))

    assert gone.code == 1
    assert f"the bundle of press {made.ids[1]} is not there: {made.record(1).bundle_id} (PZ0/pos1" in gone.err
    assert str(other) in gone.err
    assert found.code == 0, found.err


def test_a_score_that_differs_is_said_with_where_and_why(made: Played, tmp_path: Path) -> None:
    """The record states another score and map than this machine gives, and another program made it."""
    copy = made.copied(tmp_path / "copy")
    press = made.record(1)
    forged(copy, press)
    done = run("station", "replay", press.press_id, "-c", str(copy.config))

    assert done.code == 8
    assert "DIFFERS" in done.out
    assert "score map differs at 1 of" in done.out
    assert "most at x 5, y 3 of the region: -0.25" in done.out
    assert "steps of float32" in done.out
    assert "may be why: onnxruntime 1.0.0 then," in done.out
    assert "may be why: the processor had avx1024" in done.out


def forged(copy: Played, press: ArchivedPress) -> None:
    """As if another machine had judged this press: one score map pixel, the score, and the fingerprint differ."""

    def put(data: bytes) -> str:
        digest = hashlib.sha256(data).hexdigest()
        (copy.archive / "objects" / digest).write_bytes(data)
        return digest

    archive = ArchiveFolder(copy.archive)
    score_map = (
        np.frombuffer(archive.read(str(press.score_map), "map"), "<f4").reshape(press.map_shape or ()).copy()
    )
    score_map[3, 5] += 0.25
    machine = json.loads(archive.read(press.machine, "machine"))
    machine["onnxruntime"] = "1.0.0"
    machine["flags"].append("avx1024")
    other = press.model_copy(
        update={
            "score": (press.score or 0) + 0.25,
            "score_map": put(score_map.tobytes()),
            "machine": put(json.dumps(machine).encode()),
        }
    )
    (copy.archive / "presses" / f"{press.press_id}.json").write_bytes(other.encode())
    with closing(sqlite3.connect(copy.database)) as connection, connection:
        evidence = hashlib.sha256(other.encode()).digest()
        connection.execute("UPDATE presses SET evidence = ? WHERE press_id = ?", (evidence, press.press_id))


def test_another_bundle_shows_the_verdicts_that_change(made: Played, tmp_path: Path, bundle: Path) -> None:
    """The same with a limit that nothing reaches: the fail becomes a pass."""
    other = tmp_path / "lenient"
    shutil.copytree(bundle, other)
    manifest = json.loads((other / "manifest.json").read_text(encoding="utf-8"))
    manifest["threshold"]["value"] *= 1000
    (other / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    done = run("station", "replay", "--all", "-c", str(made.config), "--bundle", str(other))

    assert done.code == 0, done.err
    changed, *table = done.out.splitlines()
    assert changed.startswith(f"{made.ids[1]}  fail")
    assert "->  pass" in changed
    assert table[0] == "3 presses of this part: 1 verdicts change"
    assert table[-1].split() == ["pass", "0", "2"]


def test_json_has_both_sides(made: Played) -> None:
    """One object a line."""
    done = run("station", "replay", made.ids[0], "-c", str(made.config), "--json")
    found = json.loads(done.out)

    assert (found["is_equal"], found["verdict_then"], found["verdict"]) == (True, "pass", "pass")
    assert found["score"] == found["score_then"]


def test_only_the_newest_presses_are_kept(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """What only older ones used goes with them; their rows stay, and replay says what is gone."""
    played = Played(more(station_config(tmp_path, recording, bundle), "[archive]\npresses = 1\n"))
    press = played.record(2)
    done = run("station", "replay", played.ids[0], "-c", str(played.config))

    assert ArchiveFolder(played.archive).press_ids() == [played.ids[2]]
    assert {path.name for path in (played.archive / "objects").iterdir()} == set(press.objects)
    assert f"press {played.ids[0]} is gone" in done.err
    assert "only the newest presses are kept" in done.err


def test_the_size_is_kept_as_well(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """With room for one press, the newest one stays."""
    played = Played(more(station_config(tmp_path, recording, bundle), "[archive]\nmb = 1\n"))
    size = sum(path.stat().st_size for path in (played.archive / "objects").iterdir())

    assert 0 < size <= 1_000_000
    assert played.ids[2] in ArchiveFolder(played.archive).press_ids()


def test_a_press_that_is_larger_than_the_archive_is_kept(tmp_path: Path, made: Played) -> None:
    """The newest press stays whatever its size, and takes the place of the one before."""
    press = made.record(0)
    archive = PressArchive(tmp_path / "small", 10, 1)

    for press_id in made.ids[:2]:
        archive.keep(press.model_copy(update={"press_id": press_id}), {press.frame: b"frame"})
        assert ArchiveFolder(tmp_path / "small").press_ids() == [press_id]


def test_an_archive_that_is_off_keeps_nothing(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """And a replay says so."""
    played = Played(more(station_config(tmp_path, recording, bundle), "[archive]\npresses = 0\n"))
    done = run("station", "replay", played.ids[0], "-c", str(played.config))

    assert not played.archive.exists()
    assert done.code == 1
    assert "was never archived" in done.err


def test_an_archive_that_cannot_be_written_stops_no_inspection(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """An alarm says why; the presses are judged, counted and published."""
    config = station_config(tmp_path, recording, bundle)
    (tmp_path / "gelgate.archive").write_text("a file in its place", encoding="utf-8")
    played = Played(config)

    assert [report.word for report in played.reports] == ["pass", "fail", "pass"]
    assert played.alarms == ["archive"]
    assert any(b"cannot be written" in message.payload for message in played.said)


def test_a_disk_with_little_room_is_not_filled_by_the_archive(
    tmp_path: Path, recording: Path, bundle: Path
) -> None:
    """Below `store.free_mb` presses are judged without it."""
    config = station_config(tmp_path, recording, bundle)
    text = config.read_text(encoding="utf-8").replace(
        'path = "gelgate.db"', 'path = "gelgate.db"\nfree_mb = 1e9'
    )
    config.write_text(text, encoding="utf-8")
    played = Played(config)

    assert [report.word for report in played.reports] == ["pass", "fail", "pass"]
    assert played.alarms == ["archive", "disk"]
    assert not played.archive.exists()


def test_what_a_killed_gateway_left_is_removed(
    tmp_path: Path, recording: Path, bundle: Path, made: Played
) -> None:
    """Objects of no press go at the next start; those of a record of a newer version stay."""
    copy = made.copied(tmp_path / "copy")
    kept = {path.name for path in (copy.archive / "objects").iterdir()}
    (copy.archive / "objects" / ("0" * 64)).write_bytes(b"left")
    newer = copy.archive / "presses" / f"{made.ids[0]}.json"
    newer.write_text(
        newer.read_text(encoding="utf-8").replace('"version":1', '"version":2'), encoding="utf-8"
    )
    played = Played(copy.config)

    after = {path.name for path in (played.archive / "objects").iterdir()}
    assert kept <= after
    assert "0" * 64 not in after
