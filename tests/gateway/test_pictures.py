"""Pictures are drawn after their results have left: in order, each once, and what cannot be drawn is said."""

import json
import re
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest
from recorded_presses import make_press, messages_of, path, store
from station import MQTT, Configure, variant
from stepped_station import SteppedStation

from edge.config import load_config
from edge.core.errors import StoreError
from edge.gateway import pictures as module
from edge.gateway import recorder
from edge.gateway.inspection_session import MOST_WAITING as MOST_PRESSES_WAITING
from edge.gateway.pictures import Pictures, PressDrawing
from edge.messaging.result_payload import PressFiles
from edge.pictures.press_picture import PressCaption
from edge.store.outbox import Outbox
from edge.store.press_store import Store

__all__ = ["path", "store"]  # fixtures

IDS = [make_press(n).press_id for n in range(4)]


def files(name: str = "") -> PressFiles:
    """A JPEG and a PNG, as far as their first bytes."""
    return PressFiles(b"\xff\xd8" + name.encode(), b"\x89PNG\r\n\x1a\n" + name.encode())


def record(store: Store, pictures: Pictures, n: int, draw: Callable[[], PressFiles] = files) -> None:
    """Record a press that has only its result, and add its picture, as a recorder does."""
    press = make_press(n)
    result = messages_of(press)
    store.record_press(press, lambda recorded: [result(recorded)[0]], owes_picture=True)
    pictures.add(PressDrawing(press.press_id, draw))


def outbox(path: Path) -> list[tuple[str, bytes]]:
    """Topics and pictures that wait; of results only the topic. Each score map comes just before its sheet."""
    with Outbox(path) as opened:
        messages = [row.message for row in opened.pending("mqtt", 100)]
    for message, following in zip(messages, [*messages[1:], None], strict=True):
        if following is not None and message.topic.startswith("scoremap/"):
            assert following.topic == message.topic.replace("scoremap/", "heatmap/")
            assert bool(message.payload) == bool(following.payload)
    shown = [m for m in messages if not m.topic.startswith("scoremap/")]
    return [(m.topic, b"" if m.topic == "result" else m.payload) for m in shown]


def test_a_result_leaves_before_its_picture_is_drawn(store: Store, path: Path) -> None:
    """Two results wait while nothing is drawn; then both pictures come, in order. The retained picture is that of the
    newer press alone."""
    pictures = Pictures(store, lambda: None, keeps_last=True)
    for n in (0, 1):
        record(store, pictures, n, lambda n=n: files(str(n)))  # type: ignore[misc]
    assert outbox(path) == [("result", b"")] * 2

    pictures.step()
    assert outbox(path)[2:] == [
        (f"heatmap/{IDS[0]}", files("0").sheet),
        (f"heatmap/{IDS[1]}", files("1").sheet),
        ("last/heatmap", files("1").sheet),
    ]
    assert store.owed_pictures() == []


def test_a_wake_asks_for_a_picture(station: SteppedStation, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that draws does not take the core from the one that sends the result."""
    waiting, pictures = list[int](), station.parts.pictures
    monkeypatch.setattr(station.loop, "_on_press", lambda report: waiting.append(len(pictures._waiting)))
    station.play()
    assert waiting == [0, 0, 0]


def test_the_retained_picture_changes_once_a_press_and_after_it(store: Store, path: Path) -> None:
    """The broker has the first press and was away for two more, with their pictures. Wherever the connection breaks
    then, its `last/heatmap` names its own press, never one later than `last/press`; at the end both are one press. It
    changes once: Home Assistant shows no empty picture between two."""
    pictures, kept = Pictures(store, lambda: None, keeps_last=True), dict[str, bytes]()
    changes = list[bytes]()

    def record_all(n: int) -> None:
        store.record_press(make_press(n), messages_of(make_press(n)), owes_picture=True)
        pictures.add(PressDrawing(IDS[n], lambda: files(IDS[n])))
        pictures.step()

    def send() -> None:
        with Outbox(path) as opened:
            opened.register(["mqtt"])
            for row in opened.pending("mqtt", 100):
                kept[row.message.topic] = row.message.payload
                if row.message.topic == "last/heatmap":
                    changes.append(row.message.payload)
                    assert json.loads(kept["last/press"])["press_id"].encode() in row.message.payload
                opened.acknowledge([row.row_id], "mqtt")

    record_all(0)
    send()
    record_all(1)
    record_all(2)
    send()
    assert changes == [files(IDS[0]).sheet, files(IDS[2]).sheet]


def test_a_picture_is_queued_once(store: Store, path: Path) -> None:
    """A repeated write of a press adds its picture again, which is no longer owed."""
    pictures = Pictures(store, lambda: None)
    record(store, pictures, 0)
    pictures.step()
    pictures.add(PressDrawing(IDS[0], files))
    pictures.step()
    assert [topic for topic, _ in outbox(path)] == ["result", f"heatmap/{IDS[0]}"]


def refuse(*_: object) -> None:
    raise StoreError("database or disk is full")


def lose_the_frames(folder: Path) -> None:
    for damaged in (folder / "gelgate.archive" / "objects").iterdir():
        damaged.write_bytes(b"")


def lose_the_bundle(folder: Path) -> None:
    config = folder / "gelgate.toml"
    (before,) = re.findall(r'bundle = "(.*)"', config.read_text(encoding="utf-8"))
    other = variant(Path(before), folder / "other", revision=9)
    config.write_text(config.read_text(encoding="utf-8").replace(before, str(other)), encoding="utf-8")


@pytest.mark.parametrize(
    ("lose", "words"),
    [
        (lambda folder: None, "was not drawn before the last stop"),
        (lose_the_frames, "cannot be drawn: the judged frame of press .* is damaged"),
        (lambda folder: shutil.rmtree(folder / "gelgate.archive"), "cannot be drawn: press .* is gone"),
        (lose_the_bundle, "cannot be drawn: the bundle .* that judged press .* is not open any more"),
    ],
)
def test_a_stop_before_the_picture_is_made_good(
    config: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    lose: Callable[[Path], None],
    words: str,
) -> None:
    """After a crash the results are there. The next start draws the pictures from the archived bytes, byte for byte;
    where they are gone it sends empty ones, and says why: a subscriber need not wait."""
    expected = dict[str, PressFiles]()
    with monkeypatch.context() as killed:
        killed.setattr(Pictures, "add", lambda self, one: expected.setdefault(one.press_id, one.draw()))
        with SteppedStation(config) as station:
            station.play()
    lose(tmp_path)
    with SteppedStation(config) as station:
        station.parts.pictures.start()
        station.parts.pictures.close()

    if words.startswith("cannot"):
        expected = dict.fromkeys(expected, PressFiles())
    with Outbox(tmp_path / "gelgate.db") as opened:
        waiting = {row.message.topic: row.message.payload for row in opened.pending("mqtt", 100)}
    assert len(expected) == 3
    for press_id, drawn in expected.items():
        assert waiting[f"scoremap/{press_id}"] == drawn.score_map
        assert waiting[f"heatmap/{press_id}"] == drawn.sheet
    assert re.search(words, caplog.text)


@pytest.mark.parametrize("kind", [ValueError, MemoryError, cv2.error])
def test_a_picture_that_cannot_be_drawn_is_empty(
    store: Store, path: Path, caplog: pytest.LogCaptureFixture, kind: type[Exception]
) -> None:
    """The log has the reason; the next one comes."""

    def broken() -> PressFiles:
        raise kind("a map that is not finite")

    pictures = Pictures(store, lambda: None)
    record(store, pictures, 0, broken)
    record(store, pictures, 1)
    pictures.step()

    assert [(f"heatmap/{IDS[0]}", b""), (f"heatmap/{IDS[1]}", files().sheet)] == outbox(path)[2:4]
    assert f"the picture of press {IDS[0]} cannot be drawn: a map that is not finite" in caplog.text


def test_a_press_of_a_bundle_that_a_reload_brought_is_drawn_again(
    config: Path, tmp_path: Path, bundle: Path
) -> None:
    """As for the page; what is drawn with is what is open now, and holds nothing of the start."""
    with SteppedStation(config) as station:
        draw_again, before = station.parts.pictures._draw_again, station.bundle_id
        other = variant(bundle, tmp_path / "other", revision=2)
        config.write_text(config.read_text().replace(str(bundle), str(other)))
        station.reload()
        assert station.bundle_id != before
        station.play_presses(1)
        assert draw_again(station.results[0].press_id).sheet


def test_a_picture_that_cannot_be_queued_keeps_no_other_waiting(
    store: Store, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Whatever its error, and at the end too. It stays owed: the next start draws it."""
    pictures = Pictures(store, lambda: None)
    record(store, pictures, 0, lambda: PressFiles(b"GIF89a"))
    record(store, pictures, 1)
    pictures.close()

    assert [topic for topic, _ in outbox(path)] == ["result", "result", f"heatmap/{IDS[1]}"]
    assert store.owed_pictures() == [IDS[0]]
    assert f"the picture of press {IDS[0]} cannot be queued: not a PNG and not a JPEG" in caplog.text


def test_presses_waiting_for_the_store_hold_no_arrays(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the disk is full the presses behind the first are drawn, which takes a fraction of the memory. When there
    is room again, each picture comes."""
    drawn: list[str] = []

    def draw(rgb: object, score_map: object, caption: PressCaption, *how: object, **more: object) -> bytes:
        drawn.append(caption.press_id)
        return files(caption.press_id).sheet

    monkeypatch.setattr(recorder, "encode_press", draw)
    with SteppedStation(config) as station:
        with station.refusing("presses"):
            while not station.has_ended:
                station.play(1)
            assert (station.loop.is_halted, len(drawn)) == (True, 2)
        station.turn()
        ids = [result.press_id for result in station.results]
        pictures = [(f"heatmap/{name}", files(name).sheet) for name in ids]
        assert [row for row in outbox(station.parts.store.path) if row[0].startswith("heatmap")] == pictures
    assert (sorted(drawn), len(ids)) == (sorted(ids), 3)


def test_refused_pictures_wait_drawn(store: Store, monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    """As many as presses that wait for a store: each is drawn once, and none is lost when there is room again."""
    pictures, queue, drawn = Pictures(store, lambda: None), store.queue_picture, list[int]()

    monkeypatch.setattr(store, "queue_picture", refuse)
    for n in range(MOST_PRESSES_WAITING):
        record(store, pictures, n, lambda n=n: drawn.append(n) or files())  # type: ignore[misc]
        pictures.step()
    assert drawn == list(range(MOST_PRESSES_WAITING))
    assert {topic for topic, _ in outbox(path)} == {"result"}

    monkeypatch.setattr(store, "queue_picture", queue)
    pictures.close()
    assert (store.owed_pictures(), len(drawn)) == ([], MOST_PRESSES_WAITING)


def test_a_refused_picture_needs_no_other_press_to_come(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """After the last press of a shift the regular report asks for it, which names it once while the disk is full."""
    store, pictures = station.parts.store, station.parts.pictures

    def report() -> None:
        station.clock.sleep(11)
        station.loop.step(None)
        pictures._thread.step()

    with monkeypatch.context() as full:
        full.setattr(store, "queue_picture", refuse)
        station.play_presses(1)
        report()
        report()
    (owed,) = store.owed_pictures()
    assert caplog.text.count(f"the picture of press {owed} waits") == 1

    report()
    assert store.owed_pictures() == []
    assert f"heatmap/{owed}" in dict(outbox(store.path))


def test_pictures_that_fall_behind_are_bounded(
    store: Store, path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """What is beyond the bound stays owed, and the next start draws it."""
    monkeypatch.setattr(module, "MOST_WAITING", 2)
    pictures = Pictures(store, lambda: None)
    for n in range(3):
        record(store, pictures, n)
    pictures.step()

    assert store.owed_pictures() == [IDS[2]]
    assert f"the picture of press {IDS[2]} is not drawn: 2 others wait" in caplog.text


def test_an_end_while_drawing_keeps_order(store: Store, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Closing waits for a picture that takes longer than the thread is given, and draws the others after it."""
    monkeypatch.setattr(module, "CLOSE_S", 0.0)
    is_drawing, may_end = threading.Event(), threading.Event()

    def slow() -> PressFiles:
        is_drawing.set()
        may_end.wait(10)
        return files("slow")

    pictures = Pictures(store, lambda: None)
    pictures.start()
    record(store, pictures, 0, slow)
    is_drawing.wait(10)
    record(store, pictures, 1)
    threading.Timer(0.05, may_end.set).start()
    pictures.close()

    topics = [topic for topic, _ in outbox(path) if topic.startswith("heatmap/")]
    assert topics == [f"heatmap/{IDS[0]}", f"heatmap/{IDS[1]}"]


def test_a_picture_of_an_earlier_configuration_is_forgotten(configure: Configure, tmp_path: Path) -> None:
    """Where the newest picture is no longer retained: at every connection the topic is emptied, and what waited for it
    is not sent. A sink that announces itself to Home Assistant has it retained."""

    def is_retained(tables: str, sinks: str = "") -> tuple[bool, bool, bool]:
        config = configure(tables=tables, sinks=sinks)
        with SteppedStation(config) as station:
            station.play()
            birth = {message.topic for message in station.parts.publisher.retained_state.all()}
            waits = any(
                topic == "last/heatmap" and picture for topic, picture in outbox(tmp_path / "gelgate.db")
            )
            return load_config(config).keeps_heatmap, "last/heatmap" in birth, waits

    home_assistant = MQTT.replace(" }", ', home_assistant = "ha" }') % 1
    assert is_retained("[station]\nlast_heatmap = true") == (True, False, True)
    assert is_retained("") == (False, True, False)
    assert is_retained("", home_assistant) == (True, False, True)
