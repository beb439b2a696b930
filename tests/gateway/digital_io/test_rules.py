"""What is switched when: pure rules, worked by hand."""

import pytest

from edge.core.digital_io import OutputRule, StationView
from edge.features.outputs.actuator_driver import levels, next_blink_ns
from edge.features.outputs.trigger_reader import Debounce

MS = 1_000_000
GREEN = OutputRule(1, frozenset({"pass"}))
RED = OutputRule(2, frozenset({"fail", "halted"}))
LOCK = OutputRule(3, frozenset({"ready"}), safe=False)
BUZZER = OutputRule(4, frozenset({"halted"}), blink_ns=500 * MS)
GUARD = OutputRule(5, frozenset({"fail"}), safe=True)


def on(view: StationView, *rules: OutputRule, now_ns: int = 0) -> set[int]:
    return {
        channel
        for channel, is_on in levels(rules or (GREEN, RED, LOCK, GUARD), view, now_ns).items()
        if is_on
    }


@pytest.mark.parametrize(
    ("view", "expected"),
    [
        (StationView("starting"), {5}),
        (StationView("ready"), {3}),
        (StationView("ready", "pass"), {1, 3}),
        (StationView("ready", "fail"), {2, 3, 5}),
        (StationView("halted", "pass"), {2, 5}),
        (StationView("stopped", "fail"), {5}),
    ],
)
def test_a_verdict_shows_only_while_the_station_inspects(view: StationView, expected: set[int]) -> None:
    """In any other state each output has the level of that state, or its safe one."""
    assert on(view) == expected


def test_alarms_and_the_gel_can_be_shown() -> None:
    """Any alarm, and the one of the gel by its own name."""
    amber, lamp = OutputRule(1, frozenset({"gel"})), OutputRule(2, frozenset({"alarm"}))

    assert on(StationView("ready"), amber, lamp) == set()
    assert on(StationView("ready", alarms=frozenset({"overload"})), amber, lamp) == {2}
    assert on(StationView("ready", alarms=frozenset({"gel"})), amber, lamp) == {1, 2}


def test_one_channel_may_have_several_reasons() -> None:
    """It is on where one of them is true."""
    steady, blinking = OutputRule(2, frozenset({"fail"})), OutputRule(2, frozenset({"halted"}), blink_ns=MS)

    assert on(StationView("ready", "fail"), steady, blinking, now_ns=MS) == {2}
    assert on(StationView("halted"), steady, blinking, now_ns=MS) == set()
    assert on(StationView("halted"), steady, blinking, now_ns=2 * MS) == {2}


def test_blinking_is_half_of_the_time() -> None:
    """500 ms on, 500 ms off; the next change is known."""
    at = [0, 499, 500, 999, 1000]

    assert [bool(on(StationView("halted"), BUZZER, now_ns=ms * MS)) for ms in at] == [
        True,
        True,
        False,
        False,
        True,
    ]
    assert next_blink_ns([GREEN, BUZZER], 499 * MS) == 500 * MS
    assert next_blink_ns([GREEN], 0) is None


def test_a_pulse_is_no_level() -> None:
    pulse = OutputRule(6, frozenset({"fail"}), pulse_ns=MS, deadline_ns=MS)

    assert on(StationView("ready", "fail"), pulse) == set()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"channel": 0}, "numbered from 1"),
        ({"when": frozenset()}, "names nothing"),
        ({"pulse_ns": 1}, "a pulse and a deadline, or neither"),
        ({"deadline_ns": 1}, "a pulse and a deadline, or neither"),
        ({"pulse_ns": 1, "deadline_ns": 1, "safe": True}, "starts from off"),
        ({"pulse_ns": 1, "deadline_ns": 1, "blink_ns": 1}, "starts from off"),
        (
            {"pulse_ns": 1, "deadline_ns": 1, "when": frozenset({"fail", "halted"})},
            "follows a verdict .* found halted",
        ),
    ],
)
def test_a_rule_without_sense_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        OutputRule(**{"channel": 3, "when": frozenset({"fail"}), **change})  # type: ignore[arg-type]


def test_a_short_touch_is_no_press() -> None:
    """Shorter than the debounce time: a disturbance on the line."""
    debounce = Debounce(40 * MS)
    changes = {0: True, 39: False}

    assert not any(debounce.step(changes.get(ms), ms * MS) for ms in range(200))


def test_it_is_known_when_to_look_again() -> None:
    """Only while a contact waits to count."""
    debounce = Debounce(40 * MS)
    assert debounce.due_ns() is None
    debounce.step(True, 10 * MS)
    assert debounce.due_ns() == 50 * MS
    assert debounce.step(None, 50 * MS)
    assert debounce.due_ns() is None
