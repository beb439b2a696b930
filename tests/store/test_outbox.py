"""The outbox: in order, until every sink has it, within bounds."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest
from recorded_presses import make_press, messages_of, record

from edge.core.ports import Message
from edge.store.outbox import ROW_OVERHEAD_BYTES, Bounds, DropPriority, Outbox, drop_priority_of, enforce
from edge.store.press_store import PressRecord, Store


@pytest.fixture
def outbox(path: Path) -> Iterator[Outbox]:
    with Outbox(path) as opened:
        opened.register(["mqtt"])
        yield opened


def put(store: Store, press: PressRecord, *messages: Message) -> None:
    store.record_press(press, lambda gel: messages)


def topics(outbox: Outbox, sink: str = "mqtt") -> list[str]:
    return [row.message.topic for row in outbox.pending(sink, 1000)]


def test_a_message_comes_back_as_it_was_put_in(store: Store, outbox: Outbox) -> None:
    message = Message("x/y", b"\x00\xff", qos=0, content_type="image/png", expiry_s=9)

    put(store, make_press(1), message)

    (row,) = outbox.pending("mqtt")
    assert row.message == message


def test_a_row_leaves_when_every_sink_has_it(store: Store, outbox: Outbox) -> None:
    """One sink's acknowledgement moves that sink on, and the row stays for the other."""
    outbox.register(["mqtt", "jsonl"])
    put(store, make_press(1), Message("result", b"1"))

    outbox.acknowledge([1], "mqtt")
    assert (topics(outbox, "mqtt"), topics(outbox, "jsonl")) == ([], ["result"])

    outbox.acknowledge([1], "jsonl")
    assert outbox.status().rows == 0


def test_a_sink_taken_out_of_the_configuration_holds_nothing_back(store: Store, outbox: Outbox) -> None:
    """Rows that only the removed sink had not acknowledged leave when the others are registered."""
    outbox.register(["mqtt", "jsonl"])
    put(store, make_press(1), Message("result", b"1"))
    put(store, make_press(2), Message("result", b"2"))
    outbox.acknowledge([1], "mqtt")

    outbox.register(["mqtt"])

    assert [row.row_id for row in outbox.pending("mqtt")] == [2]
    assert outbox.status().rows == 1


def test_acknowledging_twice_or_late_is_harmless(store: Store, outbox: Outbox) -> None:
    """A row that has left has no entry in the table `settled`."""
    put(store, make_press(1), Message("result", b"1"))

    for _ in range(2):
        outbox.acknowledge([1], "mqtt")
    outbox.acknowledge([77], "mqtt")

    with outbox._database.reading("test") as connection:
        assert connection.execute("SELECT count(*) FROM settled").fetchone() == (0,)


def test_a_refused_row_is_out_of_the_way_but_kept(store: Store, outbox: Outbox) -> None:
    """The queue goes on behind it, and it can be offered again."""
    for n in (1, 2):
        put(store, make_press(n), Message("result", b"%d" % n))

    outbox.refuse(1, "mqtt", "too large")
    assert [row.row_id for row in outbox.pending("mqtt")] == [2]
    assert outbox.status().refused == 1

    assert outbox.offer_refused("mqtt") == [1]
    assert [row.row_id for row in outbox.pending("mqtt")] == [1, 2]


def test_a_retained_topic_keeps_its_newest_message_alone(store: Store, outbox: Outbox) -> None:
    """After an outage `last` and `gel` are sent once, after every result: they never show an older press."""
    for n in (1, 2, 3):
        record(store, make_press(n))

    rows = outbox.pending("mqtt", 100)

    retained = [row.message.topic for row in rows if row.message.retain]
    assert retained == ["last", "last/press", "gel"]
    assert b'"presses":3' in rows[-1].message.payload
    assert rows[-2].row_id > max(row.row_id for row in rows if row.message.topic == "result")


def test_a_refused_retained_message_never_overtakes_a_newer_one(store: Store, outbox: Outbox) -> None:
    """A refused message is replaced by the next one of its topic, so the topic never shows an older one."""
    put(store, make_press(1), Message("last", b"1", retain=True))
    outbox.refuse(1, "mqtt", "not authorized")
    put(store, make_press(2), Message("last", b"2", retain=True))
    outbox.acknowledge([2], "mqtt")

    outbox.offer_refused("mqtt")

    assert topics(outbox) == []


def test_row_ids_are_never_used_again(store: Store, outbox: Outbox) -> None:
    """An empty outbox goes on counting, so `after` and the late mark keep their meaning."""
    put(store, make_press(1), Message("result", b"1"))
    outbox.acknowledge([1], "mqtt")
    put(store, make_press(2), Message("result", b"2"))

    assert [row.row_id for row in outbox.pending("mqtt", after=1)] == [2]
    assert outbox.newest() == 2


@pytest.mark.parametrize(
    ("message", "verdict", "priority"),
    [
        (Message("heatmap/x", b"", content_type="image/png"), "fail", DropPriority.HEATMAP),
        (Message("result", b""), "pass", DropPriority.PASS),
        (Message("result", b""), "fail", DropPriority.FAIL),
        (Message("result", b""), "unsure", DropPriority.FAIL),
        (Message("result", b""), "error", DropPriority.FAIL),
        (Message("last", b"", retain=True), "pass", DropPriority.RETAINED),
    ],
)
def test_which_message_is_dropped_first(message: Message, verdict: str, priority: DropPriority) -> None:
    """Pictures first, passes next, the rest last; the one retained row per topic never."""
    assert drop_priority_of(message, verdict) is priority


def test_room_is_made_in_order_heatmaps_then_passes_then_fails(path: Path) -> None:
    """As room shrinks, first all heatmaps go, oldest first, then passes, then fails; each drop is counted."""
    verdicts = ["fail", "pass", "pass", "fail", "pass", "fail"]
    with Store(path) as store, Outbox(path) as outbox:
        for n, verdict in enumerate(verdicts):
            store.record_press(make_press(n, verdict), messages_of(make_press(n, verdict), 10_000))
        outbox_bytes = outbox.status().bytes
        row_bytes = {
            row.row_id: len(row.message.payload) + ROW_OVERHEAD_BYTES for row in outbox.pending("mqtt", 99)
        }
    assert outbox_bytes == sum(row_bytes.values())

    dropped = []
    for share in (0.95, 0.6, 0.3, 0.15, 0.05):
        with Store(path, Bounds(max_bytes=int(outbox_bytes * share))) as store, Outbox(path) as outbox:
            n = 100 + int(share * 100)
            put(store, make_press(n))  # any press enforces the bounds
            status = outbox.status()
            dropped.append(tuple(status.dropped.values()))
            assert status.bytes <= outbox_bytes * share or not [
                t for t in topics(outbox) if t not in ("last", "last/press", "last/heatmap", "gel")
            ]

    assert dropped[0] == (1, 0, 0)
    assert all(a <= b for a, b in itertools.pairwise(dropped))
    assert all(passes == 0 or heatmaps == 6 for heatmaps, passes, _ in dropped)
    assert all(fails == 0 or passes == 3 for _, passes, fails in dropped)
    assert dropped[-1] == (6, 3, 3)


def test_of_equal_priority_the_oldest_goes_first(path: Path) -> None:
    size = 1000 + ROW_OVERHEAD_BYTES
    with Store(path, Bounds(max_bytes=3 * size)) as store, Outbox(path) as outbox:
        for n in range(5):
            put(store, make_press(n), Message(f"result{n}", bytes(1000)))

        assert topics(outbox) == ["result2", "result3", "result4"]
        assert outbox.status().dropped == {"heatmap": 0, "pass": 2, "fail": 0}


def test_the_counted_size_is_that_of_the_rows(store: Store, outbox: Outbox) -> None:
    """The running total, kept by triggers, equals the sum after puts, replacements, acknowledgements and drops."""
    for n in range(20):
        store.record_press(make_press(n), messages_of(make_press(n), 500 + n))
    for row in outbox.pending("mqtt", 7):
        outbox.acknowledge([row.row_id], "mqtt")

    with outbox._database.reading("test") as connection:
        expected = connection.execute(
            "SELECT count(*), sum(length(payload) + ?) FROM outbox", (ROW_OVERHEAD_BYTES,)
        )
        assert (outbox.status().rows, outbox.status().bytes) == expected.fetchone()


def test_bounds_refuse_nonsense() -> None:
    with pytest.raises(ValueError, match="positive"):
        Bounds(max_bytes=0)
    with pytest.raises(ValueError, match="positive"):
        Bounds(max_age_s=float("nan"))


def test_a_row_goes_only_where_there_is_no_room_for_it(store: Store, outbox: Outbox) -> None:
    """The bound itself is room enough; one byte less is not. No more rows go than are too many."""
    for n in range(4):
        put(store, make_press(n), Message("result", b"1"))
    size = outbox.status().bytes // 4
    for bound, rows in ((4 * size, 4), (3 * size, 3), (2 * size - 1, 1), (size, 1), (size - 1, 0)):
        store.write("enforcing", lambda connection, bound=bound: enforce(connection, Bounds(bound), 0))
        assert outbox.status().rows == rows
