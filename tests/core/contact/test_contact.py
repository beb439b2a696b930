"""The contact table, and what a press goes through, on numbers alone."""

from dataclasses import replace
from pathlib import Path

import pytest
from contact_frames import FAINT, FREE, MS, PRESSED, RULES, at, free, names, run, seen, unconfirmed

from edge.core.contact.events import (
    NotSettledReason,
    PressBegan,
    PressNotSettled,
    PressSettled,
    ReferenceReady,
    StartedTouched,
    TriggerRepeated,
    TriggerWithoutContact,
)
from edge.core.contact.rest import Observation
from edge.core.contact.rules import gap, relearn, step, trigger
from edge.core.contact.settings import ContactSettings
from edge.core.contact.table import TABLE, Signal, State, table_markdown
from edge.core.contact.track import Track

# The table.


def test_every_state_handles_every_signal() -> None:
    """No pair is missing, none is foreign."""
    assert set(TABLE) == {(state, signal) for state in State for signal in Signal}
    assert set(TABLE.values()) == set(State)


def test_every_state_can_be_reached_and_left() -> None:
    """From warm-up every state is reached, and from every state the free gel is."""
    for start in State:
        reached, frontier = {start}, [start]
        while frontier:
            state = frontier.pop()
            new = {TABLE[state, signal] for signal in Signal} - reached
            reached |= new
            frontier += new
        assert State.NO_CONTACT in reached
        if start is State.WARM_UP:
            assert reached == set(State)


def test_a_blind_frame_moves_nothing() -> None:
    """A frame that tells nothing leaves every state as it is."""
    assert all(TABLE[state, Signal.BLIND] is state for state in State)


def test_the_manual_shows_this_table() -> None:
    """docs/contact.md holds the table as the program prints it: paste `table_markdown()` after a change."""
    page = Path(__file__).parents[3] / "docs" / "contact.md"
    assert table_markdown() in page.read_text(encoding="utf-8")


# Learning.


def test_a_still_start_learns_a_reference() -> None:
    """Half a second of warm-up, ten still frames, then presses are seen."""
    track, events = run(Track(), (seen(i * 40, None) for i in range(1, 40)))
    assert names(events) == ["ReferenceReady"]
    assert events == [ReferenceReady((1 + 13 + 9) * 40 * MS)]
    assert track.state is State.NO_CONTACT


def test_nothing_is_learnt_while_the_view_moves() -> None:
    """A change in the middle of the baseline starts the warm-up again."""
    frames = [seen(i * 40, None, change=0.2 if i == 18 else 0.0) for i in range(1, 60)]
    track, events = run(Track(), frames)
    assert [e.timestamp_ns for e in events if isinstance(e, ReferenceReady)] == [(18 + 13 + 9) * 40 * MS]
    assert track.state is State.NO_CONTACT


def test_black_frames_at_the_start_are_not_learnt() -> None:
    """However long the camera stays black."""
    dark = (replace(seen(i * 40, None), is_black=True) for i in range(1, 100))
    track, events = run(Track(), dark)
    assert (track.state, events) == (State.WARM_UP, [])


def test_a_part_that_was_there_at_the_start_is_not_a_press() -> None:
    """Against a stored reference it is noticed, never counted, and its lift makes the sensor ready."""
    track, events = run(Track(), (seen(i * 40, PRESSED) for i in range(1, 60)))
    assert names(events) == ["StartedTouched"]
    assert isinstance(events[0], StartedTouched)
    assert track.state is State.CONTACT
    track, events = run(track, at(60 * 40, [FREE] * 10))
    assert names(events) == ["ReferenceReady"]
    assert track.state is State.RECOVERY


# Onset, settling, release.


def test_one_press() -> None:
    """Began, settled on a still frame, ended: one of each."""
    track, events = run(free(), at(40, [FREE] * 5 + [PRESSED] * 20 + [FREE] * 10))
    assert names(events) == ["PressBegan", "PressSettled", "PressEnded"]
    settled = events[1]
    assert isinstance(settled, PressSettled)
    assert settled.touch.area == PRESSED
    assert track.state is State.RECOVERY


def test_debounce_one_frame_is_no_press() -> None:
    """A flash over the on level for one frame, or for less than the onset time, tells nothing."""
    assert run(free(), at(40, [FREE, PRESSED, FREE, PRESSED, FREE]))[1] == []
    assert run(free(), at(40, [PRESSED] * 5 + [FREE] * 20, spacing_ms=10))[1] == []


def test_debounce_one_clear_frame_is_no_release() -> None:
    """A part that flickers off for a frame is still the same press."""
    _, events = run(free(), at(40, [PRESSED] * 10 + [FREE] + [PRESSED] * 10 + [FREE, FREE] + [PRESSED] * 10))
    assert names(events) == ["PressBegan", "PressSettled"]


def test_hysteresis_between_the_levels_nothing_changes() -> None:
    """A faint area neither begins a press nor ends one."""
    assert run(free(), at(40, [FAINT] * 50))[1] == []
    _, events = run(free(), at(40, [PRESSED] * 10 + [FAINT] * 50))
    assert names(events) == ["PressBegan", "PressSettled"]


def test_a_press_that_never_rests_is_not_settled_in_time() -> None:
    """Three seconds after its imprint last grew it is rejected, once; rest that comes later is too late."""
    frames = at(40, [PRESSED] * 100, change=0.5) + at(4040, [PRESSED] * 50) + at(6040, [FREE] * 5)
    _, events = run(free(), frames)
    assert names(events) == ["PressBegan", "PressNotSettled", "PressEnded"]
    late = events[1]
    assert isinstance(late, PressNotSettled)
    assert late.reason is NotSettledReason.TIMED_OUT
    assert 3_000 * MS <= late.timestamp_ns - late.began_ns <= 3_200 * MS


def test_a_tap_is_not_settled() -> None:
    """Released before it was still: rejected and counted."""
    _, events = run(free(), at(40, [PRESSED] * 5, change=0.5) + at(240, [FREE] * 5))
    assert names(events) == ["PressBegan", "PressNotSettled", "PressEnded"]
    assert isinstance(events[1], PressNotSettled)
    assert events[1].reason is NotSettledReason.RELEASED


# Light contact.


def light(at_ms: float, relief: float, area: float = 0.0) -> Observation:
    return replace(seen(at_ms, area), relief=relief, texture=20 * relief)


def test_relief_alone_is_a_contact() -> None:
    """A soft part shows its texture before a large area has changed: one press, settled, ended with its relief."""
    frames = [light(40 * k, 0.03 if 5 <= k < 20 else 0.0) for k in range(1, 30)]
    assert names(run(free(), frames)[1]) == ["PressBegan", "PressSettled", "PressEnded"]


def test_relief_that_stays_after_a_press_is_no_press() -> None:
    """An imprint stays in relief for seconds: it neither holds a press open that had an area, nor begins one."""
    heavy = [light(40 * k, 0.2, 0.1) for k in range(1, 20)]
    left = [light(800 + 40 * k, 0.05 + 0.002 * (k % 2)) for k in range(50)]
    track, events = run(free(), [*heavy, *left])
    assert names(events) == ["PressBegan", "PressSettled", "PressEnded"]
    again = [light(2800 + 40 * k, 0.09) for k in range(20)]
    assert names(run(track, again)[1]) == ["PressBegan", "PressSettled"]


# A reference that was learnt from a pressed gel.


def inverse(at_ms: float, area: float = PRESSED, imprint: float = -2.0) -> Observation:
    return replace(seen(at_ms, area), imprint=imprint, strength=10.0)


def test_a_lift_from_a_pressed_reference_is_no_press() -> None:
    """It has lost structure that the reference shows: doubted at once, corrected at rest, and nothing is counted."""
    frames = [*(inverse(40 * k) for k in range(1, 7)), *at(280, [FREE] * 20)]
    track, events = run(unconfirmed(), frames)
    assert names(events) == ["ReferenceDoubted", "ReferenceCorrected", "ReferenceReady"]
    assert track.state is State.RECOVERY
    assert not track.is_confirmed


def test_a_confirmed_reference_is_not_doubted() -> None:
    """Once a press has added structure and gone, a press that looks inverse is a press."""
    press = [inverse(40 * k, imprint=2.0) for k in range(1, 20)]
    track, events = run(unconfirmed(), [*press, *at(800, [FREE] * 5)])
    assert names(events) == ["PressBegan", "PressSettled", "PressEnded"]
    _, events = run(track, (inverse(1000 + 40 * k) for k in range(1, 20)))
    assert names(events) == ["PressBegan", "PressSettled"]


def test_doubt_ends_where_the_reference_is_seen_again() -> None:
    """The part comes down again before its lift was at rest: back to no contact, and doubted at the next lift."""
    moving = [replace(inverse(40 * k), change=0.5) for k in range(1, 8)]
    track, events = run(unconfirmed(), [*moving, *at(320, [FREE] * 5)])
    assert names(events) == ["ReferenceDoubted", "ReferenceReady"]
    assert track.state is State.NO_CONTACT
    assert names(run(track, (inverse(520 + 40 * k) for k in range(8)))[1])[0] == "ReferenceDoubted"


def test_a_first_press_that_never_ends_is_doubted() -> None:
    """Half a minute without structure added, and no press before it: the reference was no free gel."""
    frames = [replace(seen(100 * k, PRESSED), imprint=0.1, strength=10.0) for k in range(1, 400)]
    _, events = run(unconfirmed(), frames)
    assert names(events)[:5] == [
        "PressBegan",
        "PressSettled",
        "PressEnded",
        "ReferenceDoubted",
        "ReferenceCorrected",
    ]
    added = [replace(frame, imprint=1.0) for frame in frames]
    assert names(run(unconfirmed(), added)[1]) == ["PressBegan", "PressSettled"]


def test_residue_neither_holds_a_press_open_nor_begins_one() -> None:
    """An imprint of 3 % of the view after a press of 80 % is a release, and only more than it is a press again."""
    frames = at(40, [0.8] * 10 + [0.03] * 100 + [0.035] * 10 + [0.06] * 10)
    _, events = run(free(), frames)
    assert names(events) == ["PressBegan", "PressSettled", "PressEnded", "PressBegan", "PressSettled"]
    assert isinstance(events[3], PressBegan)
    assert events[3].timestamp_ns >= (40 + 120 * 40) * MS


def deep(start_ms: int, strengths: list[float]) -> list[Observation]:
    """Frames that all touch the same area, with these strengths."""
    return [replace(seen(start_ms + 40 * k, PRESSED), strength=value) for k, value in enumerate(strengths)]


def test_an_imprint_that_stays_as_wide_as_the_part_is_left_when_it_sinks() -> None:
    """A third of the strength for a quarter of a second is a residue; twice the residue over it is a press."""
    frames = deep(40, [10.0] * 10 + [3.3] * 12 + [4.0] * 10 + [10.0] * 10 + [1.0] * 12)
    _, events = run(free(), frames)
    assert names(events) == ["PressBegan", "PressSettled", "PressEnded"] * 2
    assert isinstance(events[3], PressBegan)
    assert events[3].timestamp_ns >= (40 + 32 * 40) * MS


def test_a_press_that_sinks_for_a_moment_is_one_press() -> None:
    """A fingertip that rolls is nearly free for 0.2 s; a lighter hold, at half of the strength, is still a hold."""
    rolling = deep(40, [10.0] * 10 + [2.0] * 5 + [10.0] * 10 + [5.0] * 50)
    _, events = run(free(), rolling)
    assert names(events) == ["PressBegan", "PressSettled"]


def test_a_press_that_sinks_before_it_rests_is_not_judged_on_its_residue() -> None:
    """What stays after a press that never rested is no frame to score."""
    moving = [replace(frame, change=0.5) for frame in deep(40, [10.0] * 8)]
    _, events = run(free(), [*moving, *deep(360, [3.0] * 40)])
    assert names(events) == ["PressBegan", "PressNotSettled", "PressEnded"]


def test_no_press_is_lost_during_recovery() -> None:
    """The recovery time holds back the reference, not the next press."""
    _, events = run(free(), at(40, [PRESSED] * 10 + [FREE] * 4 + [PRESSED] * 10 + [FREE] * 4))
    assert names(events) == ["PressBegan", "PressSettled", "PressEnded"] * 2


def test_time_must_rise() -> None:
    """A frame is never looked at twice."""
    track, _ = step(free(), seen(40, FREE), RULES)
    with pytest.raises(ValueError, match="rise"):
        step(track, seen(40, FREE), RULES)


# Gaps.


def test_a_gap_in_a_settled_press_does_not_count_it_again() -> None:
    """Unplugged while the part presses, plugged in with the part still there: one press."""
    track, events = run(free(), at(40, [PRESSED] * 10))
    assert names(events) == ["PressBegan", "PressSettled"]
    for start in (5_000, 20_000):
        track, new = gap(track)
        assert new == ()
        track, told_after = run(track, at(start, [PRESSED] * 50))
        assert told_after == []
    assert names(run(track, at(40_000, [FREE] * 5))[1]) == ["PressEnded"]


def test_a_press_lifted_in_a_gap_ends_after_it() -> None:
    """Settled or not, it gets its one verdict event and its end."""
    track, _ = gap(run(free(), at(40, [PRESSED] * 10))[0])
    assert names(run(track, at(5_000, [FREE] * 30))[1]) == ["PressEnded"]
    track, _ = gap(run(free(), at(40, [PRESSED] * 5, change=0.5))[0])
    assert names(run(track, at(5_000, [FREE] * 30))[1]) == ["PressNotSettled", "PressEnded"]


def test_an_unsettled_press_settles_after_a_gap() -> None:
    """The settle timeout does not run while nothing is seen."""
    track, events = run(free(), at(40, [PRESSED] * 5, change=0.5))
    assert names(events) == ["PressBegan"]
    track, _ = gap(track)
    assert names(run(track, at(60_000, [PRESSED] * 30))[1]) == ["PressSettled"]


def test_frames_right_after_a_gap_are_not_believed() -> None:
    """The exposure needs a moment: 0.3 s of a wholly changed view is no press and no release."""
    track, _ = gap(free())
    assert run(track, at(1_000, [0.9] * 7 + [FREE] * 20))[1] == []
    track, _ = gap(run(free(), at(40, [PRESSED] * 10))[0])
    assert run(track, at(1_000, [FREE] * 7 + [PRESSED] * 20))[1] == []


# Triggers.


def test_a_trigger_without_contact_says_so() -> None:
    """In every state without a press."""
    for state in (State.WARM_UP, State.BASELINE, State.NO_CONTACT, State.RECOVERY):
        assert trigger(Track(state=state))[1] == (TriggerWithoutContact(state),)


def test_external_presses_wait_for_their_trigger() -> None:
    """Still for a second, no event; at the trigger the next frame is scored, once."""
    rules = ContactSettings(is_external=True)
    track, events = run(free(), at(40, [PRESSED] * 25), rules)
    assert names(events) == ["PressBegan"]
    track, new = trigger(track)
    assert new == ()
    track, events = run(track, at(1040, [PRESSED] * 5), rules)
    assert [e.sequence for e in events if isinstance(e, PressSettled)] == [1040]
    assert names(events) == ["PressSettled"]
    assert trigger(track)[1] == (TriggerRepeated(State.CONTACT),)


def test_external_press_without_a_trigger_is_counted_but_not_scored() -> None:
    """It ends as not triggered."""
    _, events = run(free(), at(40, [PRESSED] * 200 + [FREE] * 5), ContactSettings(is_external=True))
    assert names(events) == ["PressBegan", "PressNotSettled", "PressEnded"]
    assert isinstance(events[1], PressNotSettled)
    assert events[1].reason is NotSettledReason.NOT_TRIGGERED


def test_a_trigger_during_the_approach_is_kept_or_answered() -> None:
    """It arms the next press; if no press follows, an event says so."""
    rules = ContactSettings(is_external=True)
    armed, _ = trigger(run(free(), at(40, [PRESSED]), rules)[0])
    assert names(run(armed, at(80, [PRESSED] * 10), rules)[1]) == ["PressBegan", "PressSettled"]
    assert names(run(armed, at(80, [FREE] * 10), rules)[1]) == ["TriggerWithoutContact"]
    assert names(gap(armed)[1]) == ["TriggerWithoutContact"]


def test_relearning_closes_a_press() -> None:
    """A change of gel in the middle of a press leaves no press open."""
    track, _ = run(free(), at(40, [PRESSED] * 4, change=0.5))
    track, events = relearn(track)
    assert names(events) == ["PressNotSettled", "PressEnded"]
    assert track.state is State.WARM_UP
    track, _ = run(free(), at(40, [PRESSED] * 10))
    assert names(relearn(track)[1]) == ["PressEnded"]
