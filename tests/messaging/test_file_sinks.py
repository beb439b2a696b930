"""The sinks that need no broker: lines in a file, and a list in memory."""

import fcntl
import json
import os
from pathlib import Path

import pytest
from full_disk import room_for

from edge.core.errors import SinkUnavailable
from edge.core.ports import Message, Sink
from edge.core.sink_context import Station
from plugins.sinks import jsonl, memory

STATION = Station(
    "gelgate/plant/line1/press2/gel/v1", "press2", birth=lambda: [Message("state", b"{}", retain=True)]
)

PNG = b"\x89PNG\r\n\x1a\n"


def lines(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "messages.jsonl").read_text(encoding="utf-8").splitlines()]


def test_memory_keeps_messages_in_order_and_readable_after_close() -> None:
    """Birth first, then the sent messages."""
    sink = memory.plugin.open(memory.MemoryOptions(), STATION)
    sink.send(Message("result", b"1"))
    sink.close()
    sink.close()

    assert isinstance(sink, Sink)
    assert [m.topic for m in sink.messages] == ["state", "result"]


def test_a_message_becomes_a_line_and_a_picture_a_file(tmp_path: Path) -> None:
    """JSON stays JSON, text is text, an empty payload is null, a picture is a file named by its topic."""
    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path / "log"), STATION)
    sink.send(Message("result", '{"part":"Bügel"}'.encode()))
    sink.send(Message("heatmap/01ARZ3NDEKTSV4RRFFQ69G5FAV", PNG + b"x", content_type="image/png"))
    sink.send(Message("alarm/gel", b"", retain=True))
    sink.send(Message("availability", b"online", retain=True, content_type="text/plain"))
    sink.close()

    assert isinstance(sink, Sink)
    assert [line.get("payload", line.get("file")) for line in lines(tmp_path / "log")] == [
        {"part": "Bügel"},
        "heatmap/01ARZ3NDEKTSV4RRFFQ69G5FAV.png",
        None,
        "online",
    ]
    assert (tmp_path / "log" / "heatmap" / "01ARZ3NDEKTSV4RRFFQ69G5FAV.png").read_bytes() == PNG + b"x"


def test_a_folder_that_cannot_be_made_is_unavailable(tmp_path: Path) -> None:
    """The outbox keeps the row; the sentence names the folder, is the alarm `receiver`, and `check` warns of it."""
    (tmp_path / "file").write_text("")
    options = jsonl.JsonlOptions(folder=tmp_path / "file" / "log")
    sink = jsonl.plugin.open(options, STATION)

    with pytest.raises(SinkUnavailable, match=r"file/log cannot be written") as refused:
        sink.send(Message("result", b"{}"))
    assert sink.faults == (str(refused.value),)
    assert ["file/log cannot be written now" in warning for warning in options.warnings()] == [True]

    (tmp_path / "file").unlink()
    sink.send(Message("result", b"{}"))
    assert sink.faults == ()
    assert options.warnings() == []


def test_a_full_disk_leaves_no_half_line(tmp_path: Path) -> None:
    """A partly written line is removed, so the next line can be read when there is room again. It is the alarm
    `receiver`: the disk may be another one than that of the database."""
    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path), STATION)
    sink.send(Message("result", b'{"n":1}'))
    with room_for(1000), pytest.raises(SinkUnavailable) as refused:
        sink.send(Message("result", json.dumps("x" * 5000).encode()))
    assert sink.faults == (str(refused.value),)

    sink.send(Message("result", b'{"n":2}'))
    assert sink.faults == ()
    assert [line["payload"] for line in lines(tmp_path)] == [{"n": 1}, {"n": 2}]


@pytest.mark.parametrize("left", [b'{"topic":"resu', bytes(9000)])
def test_what_a_power_cut_has_left_of_a_line_damages_no_other(tmp_path: Path, left: bytes) -> None:
    """A part of a line, or zeros of a block that was never written: its message was not acknowledged."""
    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path), STATION)
    sink.send(Message("result", b'{"n":1}'))
    with (tmp_path / "messages.jsonl").open("ab") as file:
        file.write(left)

    sink.send(Message("result", b'{"n":2}'))
    assert [line["payload"] for line in lines(tmp_path)] == [{"n": 1}, {"n": 2}]


def test_a_picture_is_on_the_disk_before_it_is_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its row leaves the outbox: nothing sends it again after a power cut."""
    synced = list[bytes]()
    monkeypatch.setattr(os, "fsync", lambda fd: synced.append(Path(f"/proc/self/fd/{fd}").read_bytes()))
    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path), STATION)
    sink.send(Message("heatmap/1", PNG, content_type="image/png"))
    assert synced[0] == PNG


def test_the_line_of_another_station_is_not_taken_for_a_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two stations may have one folder: each writes its line alone."""

    def look(_: int) -> None:
        with (tmp_path / "messages.jsonl").open("ab") as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path), STATION)
    monkeypatch.setattr(os, "fsync", look)
    sink.send(Message("result", b"{}"))


def test_lines_are_rotated_within_their_room(tmp_path: Path) -> None:
    """A quarter of the room for the lines in use, and as much for those before; the newest are always there."""
    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path, keep_mb=1), STATION)
    text = "x" * 50_000
    for number in range(20):
        sink.send(Message("result", json.dumps({"number": number, "text": text}).encode()))

    sizes = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(sizes) == {"messages.jsonl", "messages.1.jsonl"}
    assert max(sizes.values()) <= 250_000
    assert lines(tmp_path)[-1]["payload"] == {"number": 19, "text": text}


def test_the_oldest_pictures_go_first(tmp_path: Path) -> None:
    """They have half of the room; pictures of an earlier process count too."""
    old = tmp_path / "heatmap" / "old.png"
    old.parent.mkdir()
    old.write_bytes(bytes(400_000))
    os.utime(old, ns=(1, 1))
    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path, keep_mb=1), STATION)
    for number in range(9):
        sink.send(Message(f"heatmap/{number}", PNG.ljust(100_000), content_type="image/png"))
        os.utime(tmp_path / "heatmap" / f"{number}.png", ns=(number + 2, number + 2))

    assert sorted(path.name for path in old.parent.iterdir()) == [f"{number}.png" for number in range(4, 9)]


def test_pictures_that_no_message_brought_stay(tmp_path: Path) -> None:
    """The folder may have nominal pictures, snapshots and whatever else beside the messages."""
    nominal = tmp_path / "nominal" / "1.png"
    nominal.parent.mkdir()
    nominal.write_bytes(bytes(2_000_000))
    os.utime(nominal, ns=(1, 1))
    sink = jsonl.plugin.open(jsonl.JsonlOptions(folder=tmp_path, keep_mb=1), STATION)
    for topic in ("heatmap/1", "overview/1", "scoremap/1"):
        sink.send(Message(topic, PNG.ljust(100_000), content_type="image/png"))

    assert len(list(tmp_path.rglob("*.png"))) == 4
