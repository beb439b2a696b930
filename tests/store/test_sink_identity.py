"""Receivers are known by name or address: their order in the configuration loses nothing and doubles nothing."""

from pathlib import Path

import pytest
from recorded_presses import make_press
from sql import execute

from edge.core.ports import Message
from edge.store.outbox import Outbox
from edge.store.press_store import Store

A, B = "mqtt:a:1883", "mqtt:b:1883"


def record(path: Path, count: int) -> None:
    with Store(path) as store:
        for n in range(count):
            store.record_press(make_press(n), lambda recorded: [Message("result", b"{}")])


def waiting(path: Path, sink: str) -> int:
    with Outbox(path) as outbox:
        return len(outbox.pending(sink, 1000))


def test_the_order_of_two_receivers_may_change(path: Path) -> None:
    """A has everything, B was away; swapped, B still gets everything, and A nothing twice."""
    record(path, 7)
    with Outbox(path) as outbox:
        outbox.register([A, B])
        for row in outbox.pending(A):
            outbox.acknowledge([row.row_id], A)
        outbox.register([B, A])

    assert (waiting(path, A), waiting(path, B)) == (0, 7)


def test_a_receiver_that_is_absent_for_a_while_gets_nothing_twice(path: Path) -> None:
    """A row that still waits for another one remembers who had it."""
    record(path, 3)
    with Outbox(path) as outbox:
        outbox.register([A, B])
        outbox.acknowledge([1], A)
        outbox.register([B])
        outbox.register([A, B])

    assert (waiting(path, A), waiting(path, B)) == (2, 3)


@pytest.mark.parametrize(
    ("names", "at_a"),
    [(["mqtt"], 2), (["mqtt", "mqtt-2"], 3)],
    ids=["one", "several: which was which is not known"],
)
def test_names_by_position_are_taken_over_where_clear(path: Path, names: list[str], at_a: int) -> None:
    """Of three rows the sink `mqtt` had one. Doubled is allowed, lost is not."""
    record(path, 3)
    with Outbox(path) as outbox:
        outbox.register([*names, B])
        outbox.acknowledge([1], "mqtt")
        outbox.register([A, B], before={"mqtt": A})

    assert (waiting(path, A), waiting(path, B)) == (at_a, 3)


def test_a_topic_with_damaged_text_is_read_and_not_a_fault_of_the_outbox(path: Path) -> None:
    """A flipped bit in one row would otherwise keep every row from being read."""
    record(path, 2)
    execute(path, "UPDATE outbox SET topic = CAST(x'726573756cff' AS TEXT) WHERE row_id = 1")

    assert waiting(path, A) == 2
