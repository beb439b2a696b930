"""The age of waiting messages is running time: no step of the wall clock makes a message old."""

from dataclasses import replace
from pathlib import Path

import pytest
from recorded_presses import make_press
from sql import execute

from edge.core.ports import Message
from edge.store.outbox import Bounds, Outbox
from edge.store.press_store import PressRecord, Store

MINUTES_NS = 600 * 10**9
DAY_NS = 86400 * 10**9


class Uptime:
    """A monotonic clock that a test sets."""

    def __init__(self) -> None:
        self.ns = 0

    def __call__(self) -> int:
        return self.ns


@pytest.fixture
def uptime() -> Uptime:
    return Uptime()


def opened(path: Path, uptime: Uptime, days: float = 1.0) -> Store:
    return Store(path, Bounds(max_age_s=days * 86400), monotonic_ns=uptime)


def record(store: Store, press: PressRecord, *messages: Message) -> None:
    store.record_press(press, lambda recorded: messages)


def topics(path: Path) -> list[str]:
    with Outbox(path) as outbox:
        return [row.message.topic for row in outbox.pending("mqtt", 1000)]


@pytest.mark.parametrize("step_days", [31, 365 * 50, -31, -365 * 50])
def test_a_step_of_the_wall_clock_drops_nothing(path: Path, uptime: Uptime, step_days: int) -> None:
    """The clock of a gateway without a battery is months late until it finds a time server, or is set back."""
    early = make_press(1, "fail")
    late = make_press(2)
    with opened(path, uptime) as store:
        record(store, early, Message("early", b""), Message("heatmap/1", b"", content_type="image/png"))
        uptime.ns += 10**9
        record(store, replace(late, time_ns=late.time_ns + step_days * DAY_NS), Message("now", b""))

    assert topics(path) == ["early", "heatmap/1", "now"]


def test_a_message_older_than_the_limit_is_dropped_and_counted_as_aged(path: Path, uptime: Uptime) -> None:
    """By running time, with a wall clock that stood still; a retained message is kept."""
    with opened(path, uptime) as store, Outbox(path) as outbox:
        record(store, make_press(1), Message("old", b""), Message("last", b"", retain=True))
        uptime.ns += DAY_NS + 1
        record(store, replace(make_press(2), time_ns=make_press(1).time_ns), Message("new", b""))
        status = outbox.status()

    assert topics(path) == ["last", "new"]
    assert status.dropped == {"heatmap": 0, "pass": 1, "fail": 0}
    assert status.aged == status.dropped


def test_running_time_goes_on_after_a_restart_and_not_while_nothing_runs(path: Path, uptime: Uptime) -> None:
    """Two runs of 0.6 days are 1.2 days, whatever the uptime of the machine says in the second."""
    with opened(path, uptime) as store:
        record(store, make_press(1), Message("old", b""))
        uptime.ns += round(0.6 * DAY_NS)
        record(store, make_press(2), Message("half", b""))
    uptime.ns = 5
    with opened(path, uptime) as store:
        record(store, make_press(3), Message("restarted", b""))
        assert topics(path) == ["old", "half", "restarted"]
        uptime.ns += round(0.6 * DAY_NS)
        record(store, make_press(4), Message("end", b""))

    assert topics(path) == ["half", "restarted", "end"]


def test_running_time_is_stored_without_presses_too(path: Path, uptime: Uptime) -> None:
    """A station that waits for parts for a day ages its messages, although nothing is pressed and it is then killed:
    every ten minutes."""
    with opened(path, uptime) as store:
        record(store, make_press(1), Message("old", b""))
        for passed_ns in (MINUTES_NS, DAY_NS + 1 - MINUTES_NS):
            uptime.ns += passed_ns
            store.gel(make_press(1).serial, make_press(1).time_ns)
            ((stored_ns,),) = execute(path, "SELECT running_ns FROM running")
            assert stored_ns >= passed_ns
        record_at_once = Store(path, Bounds(max_age_s=86400.0), monotonic_ns=Uptime())
        with record_at_once:
            record(record_at_once, make_press(2), Message("new", b""))

    assert topics(path) == ["new"]
