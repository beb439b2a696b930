"""The publisher: in order, at least once, each sink independently, without giving up."""

import json
import random
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import edge.messaging.publisher
from edge.core.backoff import Backoff
from edge.core.errors import SinkRejected, SinkUnavailable, StoreError
from edge.core.ports import Message
from edge.messaging.payloads import ALARMS, StatePayload, state_message
from edge.messaging.publisher import Publisher
from edge.messaging.publisher_lock import PublisherLock
from edge.messaging.retained_state import RetainedState
from edge.messaging.sink_worker import IDLE_S, OFFER_REFUSED_S, SinkWorker
from edge.store.outbox import Outbox
from edge.store.press_store import MakeMessages, PressRecord, Store

MakePress = Callable[..., PressRecord]
MessagesOf = Callable[..., MakeMessages]


class HandClock:
    """Time that the test sets."""

    def __init__(self) -> None:
        self.now_ns = 10**18

    def monotonic_ns(self) -> int:
        return self.now_ns

    def time_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += int(seconds * 1e9)


class ScriptedSink:
    """Accepts messages; a test can make it unreachable, lose an acknowledgement or refuse a topic."""

    def __init__(self) -> None:
        self.taken: list[Message] = []
        self.is_away = False
        self.refuses: set[str] = set()
        self.loses_next_acknowledgement = False
        self.is_closed = False

    def send(self, message: Message) -> None:
        if self.is_away:
            raise SinkUnavailable("away")
        if message.topic in self.refuses:
            raise SinkRejected(f"{message.topic} is not for you")
        self.taken.append(message)
        if self.loses_next_acknowledgement:
            self.loses_next_acknowledgement = False
            raise SinkUnavailable("no acknowledgement in time")

    def close(self) -> None:
        self.is_closed = True

    def results(self) -> list[dict[str, object]]:
        return [json.loads(m.payload) for m in self.taken if m.topic == "result"]

    def topics(self) -> list[str]:
        return [m.topic for m in self.taken if not m.topic.startswith("alarm/")]


@pytest.fixture
def outbox(path: Path) -> Iterator[Outbox]:
    with Outbox(path) as opened:
        yield opened


def worker(
    outbox: Outbox,
    sink: ScriptedSink,
    name: str = "mqtt",
    retained_state: RetainedState | None = None,
    clock: HandClock | None = None,
    changes: list[tuple[bool, str]] | None = None,
) -> SinkWorker:
    def note(name: str, is_up: bool, sentence: str) -> None:
        if changes is not None:
            changes.append((is_up, sentence))

    backoff = Backoff(random.Random(1), 0.1, 5.0)
    return SinkWorker(
        name, sink, outbox, retained_state or RetainedState(), clock or HandClock(), backoff, note
    )


def record(store: Store, messages_of: MessagesOf, *presses: PressRecord) -> None:
    for press in presses:
        store.record_press(press, messages_of(press))


def drain(worker: SinkWorker) -> None:
    while worker.step() == 0.0:
        pass


def test_rows_are_sent_in_order_and_leave(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """Twenty presses, more than one batch: every result, in order, and then an empty outbox."""
    sink = ScriptedSink()
    outbox.register(["mqtt"])
    presses = [make_press(n) for n in range(20)]
    record(store, messages_of, *presses)

    drain(worker(outbox, sink))

    assert [result["press_id"] for result in sink.results()] == [press.press_id for press in presses]
    assert outbox.status().rows == 0


def test_a_sink_that_is_away_loses_nothing(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """Away at first, and again in between: each result arrives, in order, and each change is reported once."""
    sink, changes = ScriptedSink(), []
    outbox.register(["mqtt"])
    one = worker(outbox, sink, changes=changes)
    sink.is_away = True
    record(store, messages_of, make_press(1))
    for _ in range(5):
        assert one.step() > 0
    sink.is_away = False
    drain(one)
    sink.is_away = True
    record(store, messages_of, make_press(2), make_press(3))
    one.step()
    sink.is_away = False
    drain(one)

    assert [r["press_id"] for r in sink.results()] == [make_press(n).press_id for n in (1, 2, 3)]
    assert [is_up for is_up, _ in changes] == [False, True, False, True]
    assert one.counters.failed == 6


class FullOutbox(Outbox):
    """Its disk may be full: then nothing can be stored."""

    is_full = False

    def acknowledge(self, row_id: int, sink: str) -> None:
        if self.is_full:
            raise StoreError("database or disk is full")
        super().acknowledge(row_id, sink)


def test_a_full_disk_sends_nothing_twice_and_keeps_announcing(
    store: Store,
    path: Path,
    make_press: MakePress,
    messages_of: MessagesOf,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Acknowledgements that find no room are stored later; the pauses grow, one log line, and the state is reported.

    Without the memory of accepted rows, a result was sent again at every attempt while the disk was full.
    """
    sink, changes, retained_state = ScriptedSink(), [], RetainedState()
    with FullOutbox(path) as outbox:
        outbox.register(["mqtt"])
        record(store, messages_of, make_press(1), make_press(2))
        one = worker(outbox, sink, retained_state=retained_state, changes=changes)
        outbox.is_full = True
        pauses = [one.step() for _ in range(8)]
        retained_state.announce(state_message(StatePayload(time_ns=1, state="halted", reason="full")))
        one.step()

        assert len(sink.results()) == 1
        assert sink.topics()[-1] == "state"
        assert pauses[-1] > 10 * pauses[0]
        assert [record.levelname for record in caplog.records] == ["ERROR"]
        assert [is_up for is_up, _ in changes] == [True]

        outbox.is_full = False
        drain(one)
        assert [r["press_id"] for r in sink.results()] == [make_press(n).press_id for n in (1, 2)]
        assert outbox.status().rows == 0
        assert one.counters.sent == len([m for m in sink.taken if m.topic != "state" and m.payload])


def test_rows_that_waited_are_marked_as_replayed(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """Recorded before the start or while the sink was away: late. Recorded while it accepts messages: not."""
    sink = ScriptedSink()
    outbox.register(["mqtt"])
    record(store, messages_of, make_press(1))
    one = worker(outbox, sink)
    drain(one)
    record(store, messages_of, make_press(2))
    drain(one)
    sink.is_away = True
    record(store, messages_of, make_press(3))
    one.step()
    record(store, messages_of, make_press(4))
    sink.is_away = False
    drain(one)
    record(store, messages_of, make_press(5))
    drain(one)

    assert [r["is_replayed"] for r in sink.results()] == [True, False, True, True, False]


def test_a_lost_acknowledgement_means_the_same_press_twice(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """At least once: the repetition has the same id and, except for its mark, the same content."""
    sink = ScriptedSink()
    outbox.register(["mqtt"])
    one = worker(outbox, sink)
    drain(one)
    record(store, messages_of, make_press(1))
    sink.loses_next_acknowledgement = True
    one.step()
    drain(one)

    first, second = sink.results()
    assert {**first, "is_replayed": True} == second


def test_a_refused_row_does_not_block_the_queue(store: Store, outbox: Outbox, make_press: MakePress) -> None:
    """It is counted and kept; within a minute it is offered again."""
    sink, clock = ScriptedSink(), HandClock()
    outbox.register(["mqtt"])
    one = worker(outbox, sink, clock=clock)
    sink.refuses = {"huge"}
    store.record_press(make_press(1), lambda gel: [Message("huge", b"x"), Message("result", b"{}")])
    drain(one)
    assert sink.topics() == ["result"]
    assert (one.counters.refused, outbox.status().refused) == (1, 1)

    sink.refuses = set()
    drain(one)
    assert sink.topics() == ["result"]

    clock.sleep(OFFER_REFUSED_S)
    drain(one)
    assert sink.topics() == ["result", "huge"]
    assert outbox.status().rows == 0


def test_each_sink_goes_at_its_own_pace(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """One sink away: the other has everything, and the rows stay for the first."""
    away, there = ScriptedSink(), ScriptedSink()
    outbox.register(["away", "there"])
    workers = worker(outbox, away, "away"), worker(outbox, there, "there")
    away.is_away = True
    record(store, messages_of, make_press(1), make_press(2))
    workers[0].step()
    drain(workers[1])
    assert (len(there.results()), len(away.results())) == (2, 0)

    away.is_away = False
    drain(workers[0])
    assert len(away.results()) == 2
    assert outbox.status().rows == 0


def test_retained_topics_never_go_back_in_time(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """Through an outage in the middle of a batch, `last` and `gel` only become newer."""
    sink = ScriptedSink()
    outbox.register(["mqtt"])
    one = worker(outbox, sink)
    for n in range(0, 30, 3):
        record(store, messages_of, *(make_press(n + k) for k in range(3)))
        sink.loses_next_acknowledgement = n % 2 == 0
        one.step()
    drain(one)

    lasts = [json.loads(m.payload)["time_ns"] for m in sink.taken if m.topic == "last"]
    gels = [json.loads(m.payload)["presses"] for m in sink.taken if m.topic == "gel"]
    assert lasts == sorted(lasts)
    assert gels == sorted(gels)
    assert (lasts[-1], gels[-1]) == (make_press(29).time_ns, 30)


def test_a_new_connection_hears_the_newest_retained_messages(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """A broker that restarted without memory gets the delivered `gel`, not the one sent at the start."""
    retained_state, sink = RetainedState(), ScriptedSink()
    retained_state.announce(Message("gel", b'{"presses":0}', retain=True))
    outbox.register(["mqtt"])
    one = worker(outbox, sink, retained_state=retained_state)
    record(store, messages_of, make_press(1), make_press(2))
    drain(one)

    said = {m.topic: m.payload for m in retained_state.all() if m.payload}
    said = {topic: json.loads(payload) for topic, payload in said.items() if topic != "last/heatmap"}

    assert said["gel"]["presses"] == 2
    assert said["last"]["press_id"] == make_press(2).press_id


def test_a_slower_sink_does_not_turn_the_retained_messages_back() -> None:
    """An older row delivered later by another sink does not replace a newer one."""
    retained_state = RetainedState()
    retained_state.remember(Message("gel", b"5", retain=True), 50)
    retained_state.remember(Message("gel", b"3", retain=True), 30)

    assert [m.payload for m in retained_state.all() if m.topic == "gel"] == [b"5"]


def test_announcements_bypass_the_outbox_and_only_the_latest_counts(outbox: Outbox) -> None:
    """A state that changed twice while the sink was away is published once, with its current value."""
    retained_state, sink = RetainedState(), ScriptedSink()
    one = worker(outbox, sink, retained_state=retained_state)
    sink.is_away = True
    for number, state in enumerate(("starting", "ready", "halted")):
        retained_state.announce(state_message(StatePayload(time_ns=number, state=state)))  # type: ignore[arg-type]
        one.step()
    sink.is_away = False
    drain(one)

    assert [json.loads(m.payload)["state"] for m in sink.taken if m.topic == "state"] == ["halted"]
    assert outbox.newest() == 0


def test_every_alarm_is_cleared_at_the_start(outbox: Outbox) -> None:
    """An alarm retained from a process that died does not outlive it."""
    sink = ScriptedSink()

    drain(worker(outbox, sink))

    assert {m.topic for m in sink.taken if m.retain and not m.payload} == {f"alarm/{name}" for name in ALARMS}


def test_a_refused_announcement_does_not_block_the_rows(
    store: Store, outbox: Outbox, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """A broker that forbids the state topic still gets the results."""
    retained_state, sink = RetainedState(), ScriptedSink()
    retained_state.announce(state_message(StatePayload(time_ns=0, state="ready")))
    sink.refuses = {"state"}
    outbox.register(["mqtt"])
    one = worker(outbox, sink, retained_state=retained_state)
    record(store, messages_of, make_press(1))

    drain(one)

    assert len(sink.results()) == 1


def test_pauses_double_up_to_a_ceiling_with_a_random_half() -> None:
    """Between half and all of 0.1, 0.2, 0.4 ... 5 s; success starts again."""
    backoff = Backoff(random.Random(7), 0.1, 5.0)
    pauses = [backoff.failed() for _ in range(12)]

    for n, pause in enumerate(pauses):
        assert min(5.0, 0.1 * 2**n) / 2 <= pause <= min(5.0, 0.1 * 2**n)
    assert len(set(pauses)) == 12
    backoff.succeeded()
    assert backoff.failed() <= 0.1


def test_an_idle_lane_waits(store: Store, outbox: Outbox) -> None:
    """Nothing to do: no busy loop."""
    one = worker(outbox, ScriptedSink())
    drain(one)

    assert one.step() == IDLE_S


def publisher(path: Path, **sinks: ScriptedSink) -> Publisher:
    return Publisher(path, sinks, RetainedState(), HandClock(), random.Random(1))


def test_stopping_sends_what_is_there_and_closes_the_sinks(
    store: Store, path: Path, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """The threads send the outbox; after `stop` it is empty and both sinks are closed."""
    a, b = ScriptedSink(), ScriptedSink()
    running = publisher(path, a=a, b=b)
    running.start()
    record(store, messages_of, *(make_press(n) for n in range(40)))
    running.wake()
    running.stop(drain_s=20)

    assert [len(sink.results()) for sink in (a, b)] == [40, 40]
    assert (a.is_closed, b.is_closed) == (True, True)
    with Outbox(path) as outbox:
        assert outbox.status().rows == 0


def test_what_is_announced_just_before_the_end_is_said(
    store: Store, path: Path, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """The last state, `stopped`, arrives even when the worker is in the middle of a row."""

    class Slow(ScriptedSink):
        def __init__(self) -> None:
            super().__init__()
            self.is_sending, self.may_go_on = threading.Event(), threading.Event()

        def send(self, message: Message) -> None:
            if message.topic == "result":
                self.is_sending.set()
                self.may_go_on.wait(20)
            super().send(message)

    sink = Slow()
    running = publisher(path, mqtt=sink)
    record(store, messages_of, make_press(1))
    running.start()
    assert sink.is_sending.wait(20)
    running.announce(state_message(StatePayload(time_ns=1, state="stopped")))
    threading.Timer(0.2, sink.may_go_on.set).start()  # long after the call of `stop`
    running.stop(drain_s=20)

    assert sink.topics()[-1] == "state"


def test_stopping_while_a_sink_is_away_keeps_its_rows(
    store: Store, path: Path, make_press: MakePress, messages_of: MessagesOf
) -> None:
    """The next process finds them."""
    sink = ScriptedSink()
    sink.is_away = True
    running = publisher(path, mqtt=sink)
    running.start()
    record(store, messages_of, make_press(1))
    running.stop(drain_s=1)

    sink.is_away = False
    running = publisher(path, mqtt=sink)
    running.start()
    running.stop(drain_s=20)
    assert [r["is_replayed"] for r in sink.results()] == [True]


@pytest.mark.parametrize("hangs_in", ["send", "close"])
def test_a_sink_that_never_comes_back_does_not_hold_up_the_end(
    store: Store,
    path: Path,
    make_press: MakePress,
    messages_of: MessagesOf,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    hangs_in: str,
) -> None:
    """`stop` ends, logs the sink it waited for, and has closed the others; the rows wait for the next process."""
    monkeypatch.setattr(edge.messaging.publisher, "CLOSE_S", 0.5)
    is_hanging, is_over = threading.Event(), threading.Event()

    class Hanging(ScriptedSink):
        def send(self, message: Message) -> None:
            if hangs_in == "send":
                is_hanging.set()
                is_over.wait(20)
            super().send(message)

        def close(self) -> None:
            if hangs_in == "close":
                is_hanging.set()
                is_over.wait(20)
            super().close()

    sound = ScriptedSink()
    running = publisher(path, hanging=Hanging(), sound=sound)
    record(store, messages_of, make_press(1))
    running.start()
    if hangs_in == "send":
        assert is_hanging.wait(20)
    running.stop(drain_s=0.5)

    assert is_hanging.is_set()
    assert not is_over.is_set()
    assert sound.is_closed
    assert len(sound.results()) == 1
    stuck = {"send": "publish-hanging", "close": "close-hanging"}[hangs_in]
    assert f"{stuck} did not return within 0.5 s" in caplog.text
    if hangs_in == "send":
        with Outbox(path) as outbox:
            assert outbox.status().rows > 0
    with pytest.raises(StoreError, match="another gelgate process publishes"):
        PublisherLock(path)
    is_over.set()
    running.stop()
    PublisherLock(path).close()


def test_a_second_publisher_of_the_same_database_is_refused(store: Store, path: Path) -> None:
    """Two would change the order of messages; when the first has ended the second may start."""
    first = publisher(path, mqtt=ScriptedSink())

    with pytest.raises(StoreError, match="another gelgate process publishes"):
        publisher(path, mqtt=ScriptedSink())
    first.stop()
    first.stop()
    publisher(path, mqtt=ScriptedSink()).stop()


def test_a_fault_in_a_plugin_is_logged_and_retried(
    store: Store,
    path: Path,
    make_press: MakePress,
    messages_of: MessagesOf,
    caplog: pytest.LogCaptureFixture,
) -> None:
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
    record(store, messages_of, make_press(1))
    running.wake()
    assert broken.has_recovered.wait(20)
    running.stop(drain_s=20)

    assert (len(broken.results()), len(sound.results())) == (1, 1)
    assert "KeyError: 'a bug'" in caplog.text
