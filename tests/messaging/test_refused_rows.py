"""Rows that a receiver refuses or that cannot be sent: set aside, offered in turn, never in the way of others."""

import json
import logging
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from recorded_presses import make_press
from scripted_sink import ScriptedSink, drain, worker

from edge.clock import ManualClock
from edge.core.ports import Message
from edge.logs import Text
from edge.messaging.sink_worker import BROKEN_ATTEMPTS, OFFER_REFUSED_S, OFFERED_ROWS
from edge.store.outbox import Outbox
from edge.store.press_store import Store


def put(path: Path, *messages: Message, press: int = 1) -> None:
    with Store(path) as store:
        store.record_press(make_press(press), lambda recorded: messages)


def damage(path: Path, column: str, value: bytes, row: int) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        as_text = "CAST(? AS TEXT)" if column == "topic" else "?"
        connection.execute(f"UPDATE outbox SET {column} = {as_text} WHERE row_id = ?", (value, row))


def test_many_refused_rows_are_offered_in_turn_and_all_at_once_when_one_is_accepted(path: Path) -> None:
    """A thousand refusals a minute would be work for nothing; a corrected rule needs one row to be seen. The second
    offer is a short one."""
    sink, clock, rows = ScriptedSink(), ManualClock(), OFFERED_ROWS + 8
    sink.refuses = {"result"}
    put(path, *(Message("result", b"%d" % n) for n in range(rows)))
    with Outbox(path) as outbox:
        outbox.register(["mqtt"])
        one = worker(outbox, sink, clock=clock)
        drain(one)
        assert one.counters.refused == rows
        clock.sleep(OFFER_REFUSED_S - 1)
        drain(one)
        assert one.counters.refused == rows
        clock.sleep(1)
        drain(one)
        assert one.counters.refused == rows + OFFERED_ROWS

        sink.refuses = set()
        clock.sleep(OFFER_REFUSED_S)
        drain(one)
        assert outbox.status().rows == 0

    assert sorted(int(m.payload) for m in sink.taken if m.topic == "result") == list(range(rows))


def test_a_result_that_was_refused_is_marked_as_late_when_it_comes(path: Path) -> None:
    """Else a light or a page takes an older verdict for that of the part which lies there now."""
    sink, clock = ScriptedSink(), ManualClock()
    with Outbox(path) as outbox:
        outbox.register(["mqtt"])
        one = worker(outbox, sink, clock=clock)
        drain(one)
        sink.refuses = {"result"}
        put(path, Message("result", b'{"n":1,"is_replayed":false}'))
        drain(one)
        sink.refuses = set()
        put(path, Message("result", b'{"n":2,"is_replayed":false}'), press=2)
        drain(one)
        clock.sleep(OFFER_REFUSED_S)
        drain(one)

    assert [json.loads(m.payload) for m in sink.taken if m.topic == "result"] == [
        {"n": 2, "is_replayed": False},
        {"n": 1, "is_replayed": True},
    ]


def test_looking_for_refused_rows_holds_up_no_press(path: Path) -> None:
    """A hundred thousand of them take a second to read; a press may be written meanwhile."""
    put(path, Message("result", b"{}"))
    with Outbox(path) as outbox, closing(sqlite3.connect(path, isolation_level=None)) as press:
        outbox.register(["mqtt"])
        press.execute("BEGIN IMMEDIATE")
        assert outbox.offer_first_of_kinds("mqtt") == []
        press.execute("ROLLBACK")


def test_many_refused_rows_of_one_kind_do_not_keep_back_another_kind(path: Path) -> None:
    """Each kind has its turn in every offer: `last/press` arrives although more pictures than that are too large."""
    sink, clock = ScriptedSink(), ManualClock()
    sink.refuses = {"heatmap", "last/press"}
    put(path, *(Message("heatmap", b"%d" % n) for n in range(3 * OFFERED_ROWS)), Message("last/press", b"{}"))
    with Outbox(path) as outbox:
        outbox.register(["mqtt"])
        one = worker(outbox, sink, clock=clock)
        drain(one)
        sink.refuses = {"heatmap"}
        clock.sleep(OFFER_REFUSED_S)
        drain(one)
        assert outbox.status().refused == outbox.status().rows == 3 * OFFERED_ROWS


def test_the_refusals_of_one_kind_are_one_log_line(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Until one of that kind is accepted; the sentence stays in the counters."""
    sink = ScriptedSink()
    sink.refuses = {"result"}
    put(path, *(Message("result", b"{}") for _ in range(20)))
    with Outbox(path) as outbox, caplog.at_level(logging.WARNING):
        outbox.register(["mqtt"])
        one = worker(outbox, sink)
        drain(one)

    assert caplog.text.count("refused a message on result") == 1
    assert one.counters.last_refusal == "result is not for you"


@pytest.mark.parametrize(
    ("column", "value"),
    [("payload", b"\xff{"), ("payload", b"\x80"), ("topic", b"result/\xff")],
    ids=["no JSON", "no text", "no topic"],
)
def test_a_damaged_row_is_set_aside_and_what_follows_is_sent(path: Path, column: str, value: bytes) -> None:
    """After some attempts, because a fault of the plugin looks the same; it is kept, and counted as refused."""

    class Strict(ScriptedSink):
        def send(self, message: Message) -> None:
            if message.content_type == "application/json" and message.payload:
                json.loads(message.payload)
            assert "\ufffd" not in message.topic
            super().send(message)

    sink = Strict()
    put(path, Message("result", b"{}"), Message("result", b'{"n":2}'))
    damage(path, column, value, 1)
    with Outbox(path) as outbox:
        outbox.register(["mqtt"])
        one = worker(outbox, sink)
        for _ in range(BROKEN_ATTEMPTS - 1):
            with pytest.raises((ValueError, AssertionError)):
                drain(one)
        drain(one)
        status = outbox.status()

    assert [m.payload for m in sink.taken if m.topic == "result"] == [b'{"n":2}']
    assert (status.rows, status.refused) == (1, 1)
    assert "it may be damaged" in one.counters.last_refusal


def test_a_damaged_row_that_is_offered_again_stops_nothing(path: Path) -> None:
    """The second time its first error sets it aside."""

    class Broken(ScriptedSink):
        def send(self, message: Message) -> None:
            if message.payload == b'{"n":1}':
                raise KeyError("unexpected")
            super().send(message)

    sink, clock = Broken(), ManualClock()
    put(path, Message("result", b'{"n":1}'))
    with Outbox(path) as outbox:
        outbox.register(["mqtt"])
        one = worker(outbox, sink, clock=clock)
        for _ in range(BROKEN_ATTEMPTS - 1):
            with pytest.raises(KeyError):
                drain(one)
        drain(one)
        clock.sleep(OFFER_REFUSED_S)
        drain(one)

        assert outbox.status().refused == 1


@pytest.mark.parametrize(
    ("message", "is_named"),
    [
        (Message("result", b'{"press_id": "01ABC"}'), True),
        (Message("heatmap/01ABC", b"png", content_type="image/png"), True),
        (Message("result", b"[1]"), False),
        (Message("gel", b"{}"), False),
    ],
)
def test_a_refusal_in_the_log_names_its_press(
    path: Path, caplog: pytest.LogCaptureFixture, message: Message, is_named: bool
) -> None:
    """The log line has the press id; a message of no press, or a damaged one, has none."""
    caplog.handler.setFormatter(Text())
    sink = ScriptedSink()
    sink.refuses = {message.topic}
    put(path, message)
    with Outbox(path) as outbox:
        outbox.register(["mqtt"])
        drain(worker(outbox, sink))

    (line,) = [line for line in caplog.text.splitlines() if "refused a message" in line]
    assert line.endswith(" [01ABC]") == is_named
