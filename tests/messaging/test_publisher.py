"""The publisher: a thread for each sink, which ends in time and keeps what was not sent."""

import logging
import os
import random
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from recorded_presses import make_press, record
from scripted_sink import ScriptedSink

import edge.messaging.publisher
from edge.clock import ManualClock
from edge.core.errors import StoreError
from edge.core.ports import Message
from edge.messaging.publisher import Publisher, PublisherLock
from edge.messaging.sink_worker import RetainedState
from edge.messaging.status_payloads import StatePayload
from edge.store.outbox import Outbox
from edge.store.press_store import Store


@pytest.fixture
def outbox(path: Path) -> Iterator[Outbox]:
    with Outbox(path) as opened:
        yield opened


def publisher(path: Path, **sinks: ScriptedSink) -> Publisher:
    return Publisher(path, sinks, RetainedState(), ManualClock(), random.Random(1))


def test_stopping_sends_what_is_there_and_closes_the_sinks(store: Store, path: Path) -> None:
    """The threads send the outbox; after `stop` it is empty and both sinks are closed."""
    a, b = ScriptedSink(), ScriptedSink()
    running = publisher(path, a=a, b=b)
    running.start()
    record(store, *(make_press(n) for n in range(40)))
    running.wake()
    running.stop(drain_s=60)

    assert [len(sink.results()) for sink in (a, b)] == [40, 40]
    assert (a.is_closed, b.is_closed) == (True, True)
    with Outbox(path) as outbox:
        assert outbox.status().rows == 0


def test_what_is_announced_just_before_the_end_is_said(store: Store, path: Path) -> None:
    """The last state, `stopped`, arrives even when the worker is in the middle of a row."""

    class Slow(ScriptedSink):
        def __init__(self) -> None:
            super().__init__()
            self.is_sending, self.may_go_on = threading.Event(), threading.Event()

        def send(self, message: Message) -> None:
            if message.topic == "result":
                self.is_sending.set()
                self.may_go_on.wait(60)
            super().send(message)

    sink = Slow()
    running = publisher(path, mqtt=sink)
    record(store, make_press(1))
    running.start()
    assert sink.is_sending.wait(60)
    running.announce(StatePayload(time_ns=1, state="stopped").message())
    threading.Timer(0.2, sink.may_go_on.set).start()  # long after the call of `stop`
    running.stop(drain_s=60)

    assert sink.topics()[:2] == ["result", "state"]


def test_a_sink_that_was_away_for_long_is_soon_tried_again(path: Path) -> None:
    """It retains what is so when it is back: after a halt `ready` would be five seconds old."""
    sink = ScriptedSink()
    sink.is_away = True
    running = publisher(path, mqtt=sink)
    pauses = [running.workers["mqtt"].step() for _ in range(20)]
    running.stop()
    assert 0 < max(pauses) <= 0.5


def test_stopping_while_a_sink_is_away_keeps_its_rows(
    store: Store, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The end says how many, and the next process finds them."""
    caplog.set_level(logging.INFO)
    sink = ScriptedSink()
    sink.is_away = True
    running = publisher(path, mqtt=sink)
    running.start()
    record(store, make_press(1))
    running.stop(drain_s=1)
    assert "messages in the outbox: sent when the gateway runs again" in caplog.text

    sink.is_away = False
    running = publisher(path, mqtt=sink)
    running.start()
    caplog.clear()
    running.stop(drain_s=60)
    assert [r["is_replayed"] for r in sink.results()] == [True]
    assert not [text for text in caplog.messages if "in the outbox" in text]


@pytest.mark.parametrize("hangs_in", ["send", "close"])
def test_a_sink_that_never_comes_back_does_not_hold_up_the_end(
    store: Store, path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, hangs_in: str
) -> None:
    """`stop` ends, logs the sink it waited for, and has closed the others; the rows wait for the next process."""
    monkeypatch.setattr(edge.messaging.publisher, "CLOSE_S", 0.5)
    is_hanging, is_over = threading.Event(), threading.Event()

    class Hanging(ScriptedSink):
        def send(self, message: Message) -> None:
            if hangs_in == "send":
                is_hanging.set()
                is_over.wait(60)
            super().send(message)

        def close(self) -> None:
            if hangs_in == "close":
                is_hanging.set()
                is_over.wait(60)
            super().close()

    has_result, has_closed = threading.Event(), threading.Event()

    class Sound(ScriptedSink):
        def send(self, message: Message) -> None:
            super().send(message)
            if message.topic == "result":
                has_result.set()

        def close(self) -> None:
            super().close()
            has_closed.set()

    sound = Sound()
    running = publisher(path, hanging=Hanging(), sound=sound)
    record(store, make_press(1))
    running.start()
    if hangs_in == "send":
        assert is_hanging.wait(60)
    assert has_result.wait(60)
    running.stop(drain_s=0.5)

    assert is_hanging.wait(60)
    assert not is_over.is_set()
    assert has_closed.wait(60)
    assert len(sound.results()) == 1
    stuck = {"send": "publish-hanging", "close": "close-hanging"}[hangs_in]
    (said,) = [text for text in caplog.messages if "did not return within 0.5 s" in text]
    assert stuck in said
    if hangs_in == "send":
        with Outbox(path) as outbox:
            assert outbox.status().rows > 0
    with pytest.raises(StoreError, match="another gelgate process publishes"):
        PublisherLock(path)
    is_over.set()
    monkeypatch.setattr(edge.messaging.publisher, "CLOSE_S", 60)
    running.stop()
    PublisherLock(path).close()


def test_one_process_publishes_from_a_database_by_whatever_name(store: Store, path: Path) -> None:
    """Two would change the order of messages; a second hard link is a second journal, which SQLite cannot bear."""
    link, second = path.with_name("link.db"), path.with_name("second.db")
    link.symlink_to(path)
    first = publisher(path, mqtt=ScriptedSink())

    for name in (path, link):
        with pytest.raises(StoreError, match="another gelgate process publishes"):
            publisher(name, mqtt=ScriptedSink())
    first.stop()
    first.stop()
    publisher(link, mqtt=ScriptedSink()).stop()
    os.link(path, second)
    for name in (path, second):
        with pytest.raises(StoreError, match="has 2 names"):
            PublisherLock(name)


def test_a_publisher_that_cannot_start_leaves_the_database_closed(path: Path) -> None:
    """The service may try again in the same process; what it could not use is no open file."""
    with Outbox(path) as outbox, outbox._database.writing("breaking it") as connection:
        connection.execute("DROP TABLE sinks")

    with pytest.raises(StoreError, match="sinks") as _kept:  # with the frames of the attempt
        publisher(path)

    assert path not in {file.resolve() for file in Path("/proc/self/fd").iterdir()}


def test_plugin_faults_are_retried(store: Store, path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """An exception of no known kind ends neither the thread nor the other sink; its traceback is in the log."""

    class Broken(ScriptedSink):
        def __init__(self) -> None:
            super().__init__()
            self.has_failed = False
            self.has_recovered = threading.Event()

        def send(self, message: Message) -> None:
            if message.topic == "result" and not self.has_failed:
                self.has_failed = True
                raise KeyError("a bug")
            super().send(message)
            if message.topic == "gel":
                self.has_recovered.set()

    broken, sound = Broken(), ScriptedSink()
    running = publisher(path, broken=broken, sound=sound)
    running.start()
    record(store, make_press(1))
    running.wake()
    assert broken.has_recovered.wait(60)
    running.stop(drain_s=60)

    assert (len(broken.results()), len(sound.results())) == (1, 1)
    assert "KeyError: 'a bug'" in caplog.text


@pytest.mark.parametrize(
    ("other", "is_refused"), [("left.sqlite", True), ("left", True), ("left.2.db", False)]
)
def test_databases_that_would_share_an_archive_are_not_used_at_once(
    other: str, is_refused: bool, tmp_path: Path
) -> None:
    """Each would remove the other's presses from it; after the first has ended the second may use it."""
    first = PublisherLock(tmp_path / "left.db")
    if is_refused:
        with pytest.raises(StoreError, match=r"left\.db in the same folder is in use"):
            PublisherLock(tmp_path / other)
    else:
        PublisherLock(tmp_path / other).close()
    first.close()
    PublisherLock(tmp_path / other).close()
