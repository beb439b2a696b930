"""What the page shows of a payload: what a station says, and nothing that is malformed."""

import json
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from page_messages import drift, gel, info, press, reference, state, stats

from edge.core.gel_life import GelState
from edge.core.ports import Message
from edge.messaging.payload_base import as_replayed
from edge.page.shown import LARGEST_PAYLOAD_BYTES, MOST_FOREIGN_ALARMS, Shown, readable

OWN = {
    "state": state("ready"),
    "info": info(),
    "gel": gel(5, GelState.GOOD),
    "stats": stats(mqtt="up"),
    "reference": reference(),
    "drift": drift(),
    "result": press(1)[0],
}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@pytest.mark.parametrize("kind", OWN)
def test_what_a_station_says_is_read_completely(kind: str) -> None:
    """Field by field; those of a newer station are left out."""
    content = json.loads(OWN[kind].payload)
    assert readable(kind, OWN[kind].payload) == content
    assert readable(kind, json.dumps({**content, "mood": "good"}).encode()) == content


def test_a_field_that_cannot_be_is_left_out() -> None:
    """A result without its score is still a verdict; one without a verdict and an error is no result."""
    content = json.loads(OWN["result"].payload)
    assert "score_ratio" not in readable("result", json.dumps({**content, "score_ratio": "high"}).encode())
    with pytest.raises(ValueError, match="is not what a station says"):
        readable("result", json.dumps({**content, "verdict": "good"}).encode())


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "not JSON"),
        (b"{", "not JSON"),
        (b"[" * 100_000, "has 100000 bytes"),
        (b"[" * 10_000, "not JSON"),
        (b"[1]", "expected a JSON object"),
        (b'"text"', "expected a JSON object"),
        (b"{}", "time_ns"),
        (b'{"secret":"x"}', "is not what a station says"),
        (b'{"a":"' + b"x" * LARGEST_PAYLOAD_BYTES + b'"}', "at most 65536"),
        (b"\xff\xfe", "not JSON"),
    ],
)
def test_what_is_no_payload_is_refused_in_a_sentence(payload: bytes, words: str) -> None:
    """Without a word of it."""
    with pytest.raises(ValueError, match=words) as caught:
        readable("state", payload)
    assert "secret" not in str(caught.value)


@settings(max_examples=60, deadline=None)
@given(kind=st.sampled_from(list(OWN)), changed=st.dictionaries(st.integers(0, 20), JSON, max_size=4))
def test_no_payload_ends_the_page(kind: str, changed: dict[int, Any]) -> None:
    """Any JSON in any field: it is refused, or what is shown is JSON for every browser."""
    content = json.loads(OWN[kind].payload)
    fields = list(content)
    content |= {fields[n % len(fields)]: value for n, value in changed.items()}
    shown = Shown("plant/line1/press2")
    with suppress(ValueError):
        shown.see(Message(kind, json.dumps(content).encode()))
    json.dumps([shown.station(), shown.presses()], allow_nan=False)


@pytest.mark.parametrize(
    ("topic", "payload", "words"),
    [
        *(
            (f"heatmap/{name}", b"\x89PNG", "not the picture of a press")
            for name in ("", "x", "../../etc/passwd")
        ),
        (f"heatmap/{'0' * 25}", b"\x89PNG", "not the picture of a press"),
        ("heatmap/01M80FCK12K6JA76JMBJCQMHM/F", b"\x89PNG", "not the picture of a press"),
        (f"heatmap/{'0' * 26}", bytes(5 << 20), "not the picture of a press"),
        ("last/heatmap", b"GIF89a", "not a PNG"),
        (f"heatmap/{'0' * 26}", b"<svg/>", "not a PNG"),
    ],
)
def test_a_picture_has_the_id_of_a_press(topic: str, payload: bytes, words: str) -> None:
    """Its name becomes an address of the page."""
    shown = Shown("")
    with pytest.raises(ValueError, match=words):
        shown.see(Message(topic, payload))
    assert shown.presses() == []


def test_an_alarm_that_is_not_known_is_shown_without_what_to_do() -> None:
    """No raised alarm is hidden, and the state is not green; a flood of names takes no memory and hides no other."""
    shown = Shown("")
    for name in (*(f"x{n}" for n in range(1000)), "gel"):
        shown.see(Message(f"alarm/{name}", b'{"time_ns":1,"alarm":"","text":"look at it"}'))
    alarms = shown.station()["alarms"]
    assert list(alarms) == [*(f"x{n}" for n in range(MOST_FOREIGN_ALARMS)), "gel"]
    assert (alarms["x0"]["text"], alarms["x0"]["what_to_do"]) == ("look at it", "")
    assert not alarms["x0"]["can_acknowledge"]

    shown.see(Message("alarm/x0", b""))
    assert "x0" not in shown.station()["alarms"]
    with pytest.raises(ValueError, match="a topic level has"):
        shown.see(Message("alarm/x/y", b""))


def test_a_result_that_comes_late_takes_no_place_above_newer_ones() -> None:
    """A pass that a broker had refused for a while is not that of the part which lies there now."""
    shown = Shown("")
    results = {n: press(n, picture=None)[0] for n in (1, 2, 3, 4)}
    for topic, n, is_late in (
        ("last/press", 2, False),
        ("result", 1, True),
        ("result", 4, True),
        ("result", 3, True),
        ("result", 2, True),
    ):
        shown.see(Message(topic, (as_replayed(results[n]) if is_late else results[n]).payload))
    assert [one["gel_presses"] for one in shown.presses()] == [4, 3, 2, 1]


def test_presses_keep_their_order_whatever_their_clock_says() -> None:
    """It was set back; a broker that was restored retains an old press; what comes at once is the newest."""
    shown = Shown("")
    for topic, n, sequence in (("result", 9, 5), ("result", 2, 6), ("result", 1, 7), ("last/press", 8, 4)):
        message = press(n, picture=None, sequence=sequence)[0]
        shown.see(Message(topic, message.payload if n != 2 else as_replayed(message).payload))
    assert [one["gel_presses"] for one in shown.presses()] == [1, 2, 9, 8]
