"""Recordings: written frame by frame, read back byte by byte, refused with clear errors."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from full_disk import room_for
from hypothesis import given, settings
from hypothesis import strategies as st
from small_recordings import PRODUCT, SERIAL, jpeg, write_recording

from edge.core.errors import RecordingError, StoreError
from edge.recording.format import Recording, RecordingHeader, RecordingWriter

HEADER = RecordingHeader(PRODUCT, SERIAL, (64, 48), 25.0, "mini_lr")


def test_written_and_read_back(tmp_path: Path) -> None:
    """Header, payloads, times and labels come back as they were given."""
    with RecordingWriter(tmp_path / "r", HEADER) as writer:
        writer.add(jpeg(0), 10, {"state": "press", "depth_mm": 0.4, "who": "Zoë"})
        writer.add(jpeg(1, suffix=".png"), 20)
    recording = Recording.open(tmp_path / "r")
    first, second = list(recording)
    assert recording.header == HEADER
    assert (first.frame.payload, first.frame.timestamp_ns, first.frame.sequence) == (jpeg(0), 10, 0)
    assert first.label == {"state": "press", "depth_mm": 0.4, "who": "Zoë"}
    assert (second.frame.payload, second.label) == (jpeg(1, suffix=".png"), None)
    assert not recording.is_cut


def test_version_comes_first_in_the_header(tmp_path: Path) -> None:
    """The version is the first line, so a later program may change everything after it."""
    folder = write_recording(tmp_path / "r", 1)
    assert (folder / "recording.toml").read_text().startswith("version = 1\n")


@settings(max_examples=30)
@given(product=st.text(max_size=20), serial=st.text(max_size=12))
def test_any_text_survives_the_header(
    product: str, serial: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Quotes, control characters and foreign letters in a product string keep the file readable."""
    product, serial = (text.encode("utf-8", "ignore").decode() for text in (product, serial))
    folder = tmp_path_factory.mktemp("header") / "r"
    RecordingWriter(folder, RecordingHeader(product, serial, (64, 48), 25.0)).close()
    header = Recording.open(folder).header
    assert (header.product, header.serial) == (product, serial)


def test_a_line_cut_short_is_left_out(tmp_path: Path) -> None:
    """Killed in the middle of an index line: everything before it plays, and the recording is marked as cut."""
    folder = write_recording(tmp_path / "r", 5)
    index = folder / "index.jsonl"
    index.write_bytes(index.read_bytes()[:-7])
    recording = Recording.open(folder)
    assert (len(recording), recording.is_cut) == (4, True)


def test_a_frame_without_its_line_is_left_out(tmp_path: Path) -> None:
    """Killed between the frame and its line: the unfinished frame is not part of the recording."""
    folder = write_recording(tmp_path / "r", 2)
    (folder / "frames/000002.jpg").write_bytes(jpeg(2)[:100])
    assert len(Recording.open(folder)) == 2


def header(old: str, new: str) -> Callable[[Path], object]:
    """Changes the header."""
    return lambda folder: (folder / "recording.toml").write_text(
        (folder / "recording.toml").read_text().replace(old, new)
    )


def index(change: Callable[[list[str]], list[str]]) -> Callable[[Path], object]:
    """Changes the lines of the index."""
    return lambda folder: (folder / "index.jsonl").write_text(
        "\n".join([*change((folder / "index.jsonl").read_text().splitlines()), ""])
    )


def line(file: str) -> str:
    return json.dumps({"sequence": 0, "time_ns": 0, "file": file})


def piped(name: str) -> Callable[[Path], object]:
    """Puts a named pipe in place of a file: it has no end as long as a program may write to it."""
    return lambda folder: [(folder / name).unlink(), os.mkfifo(folder / name)]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (header("version = 1", "version = 7"), r"version 7.*up to 1"),
        (header("width = 64", ""), r"width and height: mode\.0"),
        (header("width = 64", "width = 0"), "positive"),
        (header("nominal_fps = 25.0", "nominal_fps = 0.0"), "nominal_fps"),
        (header("version = 1", ""), "version None"),
        (header("version = 1", "version = ["), "cannot be read"),
        (index(lambda lines: [lines[0], "{rubbish", *lines[2:]]), "line 2"),
        (index(lambda lines: [lines[0], lines[2], lines[1], *lines[3:]]), "sequence 1"),
        (index(lambda lines: [line("../outside.jpg")]), "leads out"),
        (index(lambda lines: [line("/etc/passwd")]), "leads out"),
        (index(lambda lines: [line("frames/../../x.jpg")]), "leads out"),
        (
            lambda folder: [(folder / f"frames/{k:06d}.jpg").unlink() for k in (1, 3, 4)],
            r"lacks 3 of its 6.*000001\.jpg.*000003\.jpg.*000004\.jpg",
        ),
        (piped("recording.toml"), "a named pipe in place of"),
        (piped("index.jsonl"), "a named pipe in place of"),
        (shutil.rmtree, "gelgate record"),
    ],
)
def test_a_faulty_recording_is_refused(tmp_path: Path, damage: Callable[[Path], object], says: str) -> None:
    """Each with what was found: only the last line of an index may be cut, and no file lies outside the folder."""
    folder = write_recording(tmp_path / "r", 6)
    damage(folder)
    with pytest.raises(RecordingError, match=says):
        Recording.open(folder)


def test_nothing_is_written_over(tmp_path: Path) -> None:
    """A folder with something in it is refused, and stays as it was."""
    (tmp_path / "mine.txt").write_text("kept")
    with pytest.raises(RecordingError, match="not an empty folder"):
        RecordingWriter(tmp_path, HEADER)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_cut_recording_goes_on_after_what_is_kept(tmp_path: Path) -> None:
    """Three of five frames kept and three added, after a cut in a line: the bytes of six that were never cut."""
    folder = write_recording(tmp_path / "cut", 5)
    whole = write_recording(tmp_path / "whole", 6)
    index = folder / "index.jsonl"
    index.write_bytes(index.read_bytes()[:-7])
    frames = list(Recording.open(whole))
    with RecordingWriter.resume(folder, Recording.open(whole).header, keep=3) as writer:
        assert sorted(path.name for path in (folder / "frames").iterdir()) == [
            f"00000{k}.jpg" for k in range(3)
        ]
        assert len(writer) == 3
        for frame in frames[3:]:
            writer.add(frame.frame.payload, frame.frame.timestamp_ns, frame.label)
    files = sorted(path.relative_to(whole) for path in whole.rglob("*.*"))
    assert sorted(path.relative_to(folder) for path in folder.rglob("*.*")) == files
    assert all((folder / path).read_bytes() == (whole / path).read_bytes() for path in files)


def test_going_on_after_nothing_begins_again(tmp_path: Path) -> None:
    """A header cut short and a file that is not the recording's: the one is written, the other stays."""
    (tmp_path / "recording.toml").write_text("vers")
    (tmp_path / "mine.txt").write_text("kept")
    with RecordingWriter.resume(tmp_path, HEADER, keep=0) as writer:
        writer.add(jpeg(0), 0)
    assert (Recording.open(tmp_path).header, (tmp_path / "mine.txt").read_text()) == (HEADER, "kept")


@pytest.mark.parametrize(
    ("header", "keep", "says"),
    [
        (HEADER, 5, "has 4 complete frames, expected at least 5"),
        (RecordingHeader("other", SERIAL, (64, 48), 25.0, "mini_lr"), 2, "choose another folder"),
    ],
)
def test_another_recording_is_refused(tmp_path: Path, header: RecordingHeader, keep: int, says: str) -> None:
    """Fewer complete lines than requested, or another sensor: refused, and nothing is changed."""
    with RecordingWriter(tmp_path / "r", HEADER) as writer:
        for k in range(5):
            writer.add(jpeg(k), k)
    index = tmp_path / "r" / "index.jsonl"
    index.write_bytes(index.read_bytes()[:-7])
    before = index.read_bytes()
    with pytest.raises(RecordingError, match=says):
        RecordingWriter.resume(tmp_path / "r", header, keep=keep)
    assert index.read_bytes() == before
    assert len(list((tmp_path / "r" / "frames").iterdir())) == 5


@pytest.mark.parametrize(("size", "beyond_index"), [(5000, 500), (10, 20), (10, 0)])
def test_a_full_disk_keeps_what_was_recorded(tmp_path: Path, size: int, beyond_index: int) -> None:
    """No room for the frame, for the end of its line, or for its line at all: a clear error, and two frames play."""
    folder = tmp_path / "r"
    with RecordingWriter(folder, HEADER) as writer:
        writer.add(b"a" * size, 0)
        writer.add(b"b" * size, 1)
        room = (folder / "index.jsonl").stat().st_size + beyond_index
        with room_for(room), pytest.raises(StoreError, match="stops after 2 frames"):
            writer.add(b"c" * size, 2)
    recording = Recording.open(folder)
    assert [entry.frame.payload for entry in recording] == [b"a" * size, b"b" * size]
    assert not recording.is_cut


def test_an_unwritable_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be started"):
        RecordingWriter(tmp_path / "file" / "r", HEADER)


def test_a_frame_removed_while_playing_is_named(tmp_path: Path) -> None:
    """Frames are read at access; one that is missing then is named."""
    folder = write_recording(tmp_path / "r", 2)
    recording = Recording.open(folder)
    (folder / "frames/000001.jpg").unlink()
    assert recording[0].frame.payload == jpeg(0)
    with pytest.raises(RecordingError, match=r"000001\.jpg"):
        recording[1]
