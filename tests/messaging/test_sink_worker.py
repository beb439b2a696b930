"""One sink's worker: rows in order, at least once, without giving up; the retained state never goes back."""

import json
import random
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from recorded_presses import make_press, record
from scripted_sink import ScriptedSink, drain, worker

from edge.clock import ManualClock
from edge.core.backoff import Backoff
from edge.core.errors import StoreError
from edge.core.ports import Message
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.sink_worker import IDLE_S, OFFER_REFUSED_S, RetainedState
from edge.messaging.status_payloads import QuestionsPayload, StatePayload
from edge.store.outbox import Outbox
from edge.store.press_store import Store


@pytest.fixture
def outbox(path: Path) -> Iterator[Outbox]:
    with Outbox(path) as opened:
        opened.register(["mqtt"])
        yield opened


@pytest.fixture
def sink() -> ScriptedSink:
    return ScriptedSink()


def test_rows_are_sent_in_order_and_leave(store: Store, outbox: Outbox, sink: ScriptedSink) -> None:
    """Twenty presses, more than one batch: every result, in order, and then an empty outbox."""
    presses = [make_press(n) for n in range(20)]
    record(store, *presses)

    drain(worker(outbox, sink))

    assert [result["press_id"] for result in sink.results()] == [press.press_id for press in presses]
    assert outbox.status().rows == 0


def test_a_sink_that_is_away_loses_nothing(
    store: Store, outbox: Outbox, sink: ScriptedSink, caplog: pytest.LogCaptureFixture
) -> None:
    """Away at first, and again in between: each result arrives, in order, and each change is logged once."""
    caplog.set_level("INFO")
    one = worker(outbox, sink)
    sink.is_away = True
    record(store, make_press(1))
    for _ in range(5):
        assert one.step() > 0
    sink.is_away = False
    drain(one)
    sink.is_away = True
    record(store, make_press(2), make_press(3))
    one.step()
    sink.is_away = False
    drain(one)

    assert [r["press_id"] for r in sink.results()] == [make_press(n).press_id for n in (1, 2, 3)]
    assert [line.levelname for line in caplog.records] == ["WARNING", "INFO", "WARNING", "INFO"]
    assert one.counters.failed == 6


class FullOutbox(Outbox):
    """Its disk may be full: then nothing can be stored."""

    is_full = False

    def acknowledge(self, row_ids: Iterable[int], sink: str) -> None:
        if self.is_full:
            raise StoreError("database or disk is full")
        super().acknowledge(row_ids, sink)


def test_a_full_disk_sends_nothing_twice_and_keeps_announcing(
    store: Store, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Acknowledgements that find no room are stored later; the pauses grow, one log line, and the state is reported.
    Without the memory of accepted rows, a result was sent again at every attempt while the disk was full. What comes
    after them is not late."""
    sink, retained_state = ScriptedSink(), RetainedState()
    with FullOutbox(path) as outbox:
        outbox.register(["mqtt"])
        record(store, make_press(1), make_press(2))
        one = worker(outbox, sink, retained_state=retained_state)
        outbox.is_full = True
        pauses = [one.step() for _ in range(8)]
        retained_state.announce(StatePayload(time_ns=1, state="halted", reason="full").message())
        one.step()

        assert len(sink.results()) == 2
        assert sink.topics()[-1] == "state"
        assert pauses[-1] > 10 * pauses[0]
        assert [line.levelname for line in caplog.records if line.levelname != "INFO"] == ["ERROR"]
        assert (one.counters.is_up, one.counters.failed) == (True, 9)

        outbox.is_full = False
        drain(one)
        assert [r["press_id"] for r in sink.results()] == [make_press(n).press_id for n in (1, 2)]
        assert outbox.status().rows == 0
        rows = [m for m in sink.taken if m.topic != "state" and (m.payload or m.topic == "last/heatmap")]
        assert one.counters.sent == len(rows)

        for number, is_full in ((3, True), (4, False)):
            payload = json.dumps({"press_id": f"{number}", "is_replayed": False}).encode()
            store.record_press(make_press(number), lambda recorded, sent=payload: [Message("result", sent)])
            outbox.is_full = is_full
            one.step()
            outbox.is_full = False
            one.step()
        assert not sink.results()[-1]["is_replayed"]


def test_rows_that_waited_are_marked_as_replayed(store: Store, outbox: Outbox, sink: ScriptedSink) -> None:
    """Recorded before the start or while the sink was away: late. Recorded while it accepts messages: not."""
    record(store, make_press(1))
    one = worker(outbox, sink)
    drain(one)
    record(store, make_press(2))
    drain(one)
    sink.is_away = True
    record(store, make_press(3))
    one.step()
    record(store, make_press(4))
    sink.is_away = False
    drain(one)
    record(store, make_press(5))
    drain(one)

    assert [r["is_replayed"] for r in sink.results()] == [True, False, True, True, False]


def test_rows_that_waited_for_a_slow_acknowledgement_are_replayed(store: Store, outbox: Outbox) -> None:
    """The receiver answers after five seconds: the press made meanwhile is late, and the one after it is not."""
    clock = ManualClock()

    class Slow(ScriptedSink):
        takes_s = 5.0

        def send(self, message: Message) -> None:
            if message.topic == "result" and self.takes_s:
                clock.sleep(self.takes_s)
                self.takes_s = 0.0
                record(store, make_press(2))
            super().send(message)

    sink = Slow()
    one = worker(outbox, sink, clock=clock)
    record(store, make_press(1))
    drain(one)
    record(store, make_press(3))
    drain(one)

    assert [r["is_replayed"] for r in sink.results()] == [False, True, False]


def test_a_change_of_the_state_waits_for_no_row_that_waits(store: Store, outbox: Outbox) -> None:
    """The station ends while rows are sent: `stopped` is the next message, not the last of them."""
    retained_state = RetainedState()
    stopped = StatePayload(time_ns=0, state="stopped").message()

    class Ending(ScriptedSink):
        def send(self, message: Message) -> None:
            super().send(message)
            if message.topic == "result":
                retained_state.announce(stopped)

    sink = Ending()
    record(store, make_press(1))
    drain(worker(outbox, sink, retained_state=retained_state))

    assert sink.topics()[:2] == ["result", "state"]


def test_a_lost_acknowledgement_is_a_press_twice(store: Store, outbox: Outbox, sink: ScriptedSink) -> None:
    """At least once: the repetition has the same id and, except for its mark, the same content."""
    one = worker(outbox, sink)
    drain(one)
    record(store, make_press(1))
    sink.loses_next_acknowledgement = True
    one.step()
    drain(one)

    first, second = sink.results()
    assert {**first, "is_replayed": True} == second


def test_what_was_accepted_before_a_failure_is_acknowledged(
    store: Store, outbox: Outbox, sink: ScriptedSink
) -> None:
    """In one transaction, with the step that sent it; what failed waits, and all after it."""
    one = worker(outbox, sink)
    record(store, make_press(1))
    rows = [row.message.topic for row in outbox.pending("mqtt")]
    sink.loses_acknowledgements_of = "last/press"
    one.step()

    assert [row.message.topic for row in outbox.pending("mqtt")] == rows[rows.index("last/press") :]
    assert one.counters.sent == rows.index("last/press") > 1


def test_a_refused_row_does_not_block_the_queue(store: Store, outbox: Outbox, sink: ScriptedSink) -> None:
    """It is counted and kept; within a minute it is offered again."""
    clock = ManualClock()
    one = worker(outbox, sink, clock=clock)
    sink.refuses = {"huge"}
    store.record_press(make_press(1), lambda gel: [Message("huge", b"{}"), Message("result", b"{}")])
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


def test_each_sink_goes_at_its_own_pace(store: Store, outbox: Outbox) -> None:
    """One sink away: the other has everything, and the rows stay for the first."""
    away, there = ScriptedSink(), ScriptedSink()
    outbox.register(["away", "there"])
    workers = worker(outbox, away, "away"), worker(outbox, there, "there")
    away.is_away = True
    record(store, make_press(1), make_press(2))
    workers[0].step()
    drain(workers[1])
    assert (len(there.results()), len(away.results())) == (2, 0)

    away.is_away = False
    drain(workers[0])
    assert len(away.results()) == 2
    assert outbox.status().rows == 0


def test_retained_topics_never_go_back_in_time(store: Store, outbox: Outbox, sink: ScriptedSink) -> None:
    """Through an outage in the middle of a batch, `last` and `gel` only become newer."""
    one = worker(outbox, sink)
    for n in range(0, 30, 3):
        record(store, *(make_press(n + k) for k in range(3)))
        sink.loses_next_acknowledgement = n % 2 == 0
        one.step()
    drain(one)

    lasts = [json.loads(m.payload)["time_ns"] for m in sink.taken if m.topic == "last"]
    gels = [json.loads(m.payload)["presses"] for m in sink.taken if m.topic == "gel"]
    assert lasts == sorted(lasts)
    assert gels == sorted(gels)
    assert (lasts[-1], gels[-1]) == (make_press(29).time_ns, 30)


def test_a_new_connection_hears_what_is_newest(store: Store, outbox: Outbox, sink: ScriptedSink) -> None:
    """A broker that restarted without memory gets the delivered `gel`, not the one sent at the start."""
    retained_state = RetainedState()
    retained_state.announce(Message("gel", b'{"presses":0}', retain=True))
    one = worker(outbox, sink, retained_state=retained_state)
    record(store, make_press(1), make_press(2))
    drain(one)

    said = {m.topic: m.payload for m in retained_state.all() if m.payload}
    said = {topic: json.loads(payload) for topic, payload in said.items() if topic != "last/heatmap"}

    assert said["gel"]["presses"] == 2
    assert said["last"]["press_id"] == make_press(2).press_id


def test_a_new_connection_hears_nothing_older_than_what_may_have_arrived(
    store: Store, outbox: Outbox, sink: ScriptedSink
) -> None:
    """The acknowledgement of the newest `last/press` is lost: the receiver has it, and would go back to that before."""
    retained_state = RetainedState()
    one = worker(outbox, sink, retained_state=retained_state)
    record(store, make_press(1))
    drain(one)
    record(store, make_press(2))
    sink.loses_acknowledgements_of = "last/press"
    one.step()

    assert "last/press" not in {m.topic for m in retained_state.all()}
    drain(one)
    (said,) = (json.loads(m.payload) for m in retained_state.all() if m.topic == "last/press")
    assert said["press_id"] == make_press(2).press_id


def test_a_slower_sink_does_not_turn_the_retained_messages_back() -> None:
    """An older row delivered later by another sink does not replace a newer one; the first row of a database counts."""
    retained_state = RetainedState()
    for row, payload in ((1, b"1"), (50, b"5"), (30, b"3")):
        retained_state.remember(Message("gel", payload, retain=True), row)
        newest = [m.payload for m in retained_state.all() if m.topic == "gel"]
        assert newest == [b"1" if row == 1 else b"5"]


def test_announcements_bypass_the_outbox_and_the_latest_counts(outbox: Outbox, sink: ScriptedSink) -> None:
    """A state that changed twice while the sink was away is published once, with its current value."""
    retained_state = RetainedState()
    one = worker(outbox, sink, retained_state=retained_state)
    sink.is_away = True
    for number, state in enumerate(("starting", "ready", "halted")):
        retained_state.announce(StatePayload(time_ns=number, state=state).message())  # type: ignore[arg-type]
        one.step()
    sink.is_away = False
    drain(one)

    assert [json.loads(m.payload)["state"] for m in sink.taken if m.topic == "state"] == ["halted"]
    assert outbox.newest() == 0


def test_every_alarm_is_cleared_at_the_start(outbox: Outbox, sink: ScriptedSink) -> None:
    """An alarm retained from a process that died does not outlive it."""

    drain(worker(outbox, sink))

    assert {m.topic for m in sink.taken if m.retain and not m.payload} == {f"alarm/{name}" for name in ALARMS}


def test_a_refused_announcement_is_said_again_when_it_is_still_so(outbox: Outbox, sink: ScriptedSink) -> None:
    """Otherwise the broker would retain `ready` of a station that is halted, until the next change or connection. It is
    said again in its own time, not in every step."""
    retained_state, clock = RetainedState(), ManualClock()
    one = worker(outbox, sink, retained_state=retained_state, clock=clock)
    retained_state.announce(StatePayload(time_ns=1, state="ready").message())
    drain(one)
    sink.refuses = {"state"}
    retained_state.announce(StatePayload(time_ns=2, state="halted", reason="full").message())
    drain(one)
    clock.sleep(OFFER_REFUSED_S)
    for _ in range(3):
        drain(one)
    assert sink.refused == ["state", "state"]
    sink.refuses = set()
    drain(one)
    assert [m.topic for m in sink.taken if m.topic == "state"] == ["state"]
    clock.sleep(OFFER_REFUSED_S)
    for _ in range(3):
        drain(one)

    states = [json.loads(m.payload)["state"] for m in sink.taken if m.topic == "state"]
    assert states == ["ready", "halted"]


def test_a_topic_always_refused_keeps_back_no_other_and_no_row(
    store: Store, outbox: Outbox, sink: ScriptedSink
) -> None:
    """As where a broker's rules lack `questions`, which change with every press."""
    record(store, make_press(1))
    retained_state, clock = RetainedState(), ManualClock()
    one = worker(outbox, sink, retained_state=retained_state, clock=clock)
    sink.refuses = {"state", "questions"}
    retained_state.announce(StatePayload(time_ns=2, state="halted", reason="full").message())
    drain(one)
    assert len(sink.results()) == 1
    sink.refuses = {"questions"}
    for second in range(0, round(2 * OFFER_REFUSED_S), 5):
        retained_state.announce(QuestionsPayload(time_ns=second, per_day=10).message())
        drain(one)
        clock.sleep(5)

    assert [m.topic for m in sink.taken if m.topic == "state"] == ["state"]


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
    one = worker(outbox, ScriptedSink())
    drain(one)

    assert one.step() == IDLE_S
