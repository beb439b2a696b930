"""The contact table and its rules, on numbers alone."""

import random
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.contact.rules import (
    TABLE,
    ContactSettings,
    Event,
    NotSettledReason,
    Observation,
    PressBegan,
    PressEnded,
    PressNotSettled,
    PressSettled,
    ReferenceReady,
    Signal,
    StartedTouched,
    State,
    Touch,
    Track,
    TriggerRepeated,
    TriggerWithoutContact,
    gap,
    relearn,
    step,
    table_markdown,
    trigger,
)

RULES = ContactSettings()
FREE, FAINT, PRESSED = 0.0, 0.007, 0.10
MS = 1_000_000


def seen(
    at_ms: float, area: float | None, change: float = 0.0, motion: float = 0.001, sequence: int = -1
) -> Observation:
    """One frame; its sequence is its time in milliseconds unless given."""
    touch = None if area is None else Touch(area)
    return Observation(round(at_ms * MS), int(at_ms) if sequence < 0 else sequence, touch, change, motion)


def run(
    track: Track, frames: Iterable[Observation], rules: ContactSettings = RULES
) -> tuple[Track, list[Event]]:
    events: list[Event] = []
    for frame in frames:
        track, new = step(track, frame, rules)
        events += new
    return track, events


def at(start_ms: int, areas: Iterable[float], spacing_ms: int = 40, change: float = 0.0) -> list[Observation]:
    return [seen(start_ms + i * spacing_ms, area, change) for i, area in enumerate(areas)]


def free() -> Track:
    return Track(state=State.NO_CONTACT, last_ns=0, still_frames=1, is_confirmed=True)


def unconfirmed() -> Track:
    """A reference that nothing has confirmed, as after a first start."""
    return replace(free(), is_confirmed=False)


def names(events: Iterable[Event]) -> list[str]:
    return [type(event).__name__ for event in events]


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


def pressed(at_ms: float, strength: float, motion: float = 0.01, change: float = 0.0) -> Observation:
    """A frame of a press as deep as this; its sequence is its time in milliseconds."""
    return replace(seen(at_ms, PRESSED, change, motion), strength=strength)


def ramped(spacing_ms: float, ramp_ms: float, hold_ms: float) -> list[Observation]:
    """A press that deepens evenly to 10 and is held; a part that moves so slowly changes few pixels in a frame."""
    times = [k * spacing_ms for k in range(1, int((ramp_ms + hold_ms) / spacing_ms) + 1)]
    return [pressed(40 + t, 10 * min(t / ramp_ms, 1.0)) for t in times]


@pytest.mark.parametrize("fps", [5.0, 10.0, 15.0, 18.75, 25.0, 30.0, 60.0])
@pytest.mark.parametrize("ramp_ms", [300, 1000, 2000])
def test_a_slow_ramp_is_no_rest(fps: float, ramp_ms: float) -> None:
    """Whatever the frame rate, the frame that is scored lies in the hold."""
    _, events = run(free(), ramped(1000 / fps, ramp_ms, 800))
    chosen = [e.sequence for e in events if isinstance(e, PressSettled)]
    assert len(chosen) == 1
    assert chosen[0] >= 40 + 0.95 * ramp_ms


@pytest.mark.parametrize("fps", [5.0, 15.0, 60.0])
def test_rest_is_as_long_at_any_frame_rate(fps: float) -> None:
    """From the last growth to the decision 0.2 s pass, and at most two frames more."""
    _, events = run(free(), ramped(1000 / fps, 1000, 1500))
    [decided] = [e.timestamp_ns / 1e9 for e in events if isinstance(e, PressSettled)]
    assert 1.04 + 0.15 <= decided <= 1.04 + 0.25 + 2 / fps


def test_a_press_lifted_while_it_deepens_is_not_settled() -> None:
    """It never rested: counted, and rejected."""
    _, events = run(free(), [*ramped(40, 1500, 0), *at(1600, [FREE] * 5)])
    assert names(events) == ["PressBegan", "PressNotSettled", "PressEnded"]


def test_texture_that_deepens_is_growth() -> None:
    """The outline of a soft part may rest while its texture still sinks in."""
    frames = [replace(pressed(40 + 40 * k, 10.0), texture=0.2 * min(k, 20)) for k in range(40)]
    _, events = run(free(), frames)
    [decided] = [e for e in events if isinstance(e, PressSettled)]
    assert decided.sequence >= 40 + 40 * 18


def test_the_deepest_frame_at_rest_is_scored() -> None:
    """A hand trembles: the frames at rest differ in depth. Of those as deep, the stillest; of equals the later."""
    depths = [10.0, 9.5, 10.4, 9.6, 10.0, 9.8]
    frames = [pressed(40 + k * 40, depth) for k, depth in enumerate(depths)]
    _, events = run(free(), frames)
    assert [e.sequence for e in events if isinstance(e, PressSettled)] == [120]
    motions = [0.9, 0.05, 0.01, 0.03, 0.01, 0.03]
    level = [pressed(40 + k * 40, 10.0, motion) for k, motion in enumerate(motions)]
    _, events = run(free(), level)
    assert [e.sequence for e in events if isinstance(e, PressSettled)] == [200]


def test_a_part_that_is_being_lifted_does_not_rest() -> None:
    """Slowly up again after a ramp: no frame of it is at rest."""
    lifted = [pressed(1040 + k * 40, 10.0 * (1 - k / 25)) for k in range(1, 20)]
    _, events = run(free(), [*ramped(40, 1000, 0), *lifted, *at(1900, [FREE] * 5)])
    assert names(events) == ["PressBegan", "PressNotSettled", "PressEnded"]


def test_a_slide_is_no_rest() -> None:
    """More than a fifth of the touched pixels have changed in 0.2 s, though the depth is the same."""
    frames = [pressed(40 + 40 * k, 10.0, change=0.021 if k < 40 else 0.019) for k in range(50)]
    _, events = run(free(), frames)
    [decided] = [e for e in events if isinstance(e, PressSettled)]
    assert decided.timestamp_ns == (40 + 40 * 40) * MS


def test_a_long_ramp_has_all_its_time() -> None:
    """The timeout runs from the last growth: a part that takes six seconds to go down settles."""
    _, events = run(free(), ramped(40, 6000, 600))
    assert names(events) == ["PressBegan", "PressSettled"]


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


# Properties.


def check_grammar(events: Iterable[Event]) -> None:
    """began (settled | not settled) ended, again and again; the last press may be unfinished."""
    expected: tuple[type, ...] = (PressBegan,)
    following: dict[type, tuple[type, ...]] = {
        PressBegan: (PressSettled, PressNotSettled),
        PressSettled: (PressEnded,),
        PressNotSettled: (PressEnded,),
        PressEnded: (PressBegan,),
    }
    for event in events:
        if type(event) in following:
            assert isinstance(event, expected), f"{event} where {expected} was due"
            expected = following[type(event)]


HAPPENINGS = st.one_of(
    st.tuples(
        st.sampled_from([FREE, FAINT, PRESSED, 0.9]),
        st.sampled_from([0.0, 0.01, 0.5]),
        st.integers(1, 400),
        st.booleans(),
    ),
    st.sampled_from(["gap", "trigger", "relearn"]),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(HAPPENINGS, max_size=120), st.booleans(), st.sampled_from(list(State)))
def test_whatever_happens_each_press_has_one_verdict(
    happenings: list[tuple[float, float, int, bool] | str], is_external: bool, state: State
) -> None:
    """Any frames at any times with any interruption: the events keep their grammar and name no frame twice."""
    track = Track() if state in (State.WARM_UP, State.BASELINE) else free()
    rules = ContactSettings(is_external=is_external, warm_up_s=0.1, baseline_frames=2, recovery_s=0.5)
    events: list[Event] = []
    now = 0
    for sequence, happening in enumerate(happenings):
        if isinstance(happening, str):
            track, new = {"gap": gap, "trigger": trigger, "relearn": relearn}[happening](track)
        else:
            area, change, wait_ms, is_black = happening
            now += wait_ms * MS
            frame = Observation(now, sequence, Touch(area), change, change, is_black and area == 0.9)
            track, new = step(track, frame, rules)
        events += new
    check_grammar(events)
    scored = [e.sequence for e in events if isinstance(e, PressSettled)]
    assert len(scored) == len(set(scored))
    assert scored == sorted(scored)


@dataclass(frozen=True)
class Press:
    """One press of a robot: ramp down, hold, ramp up, and the free time after it, seconds."""

    ramp_s: float
    hold_s: float
    free_s: float


def depth_at(t: float, presses: list[Press], start: float) -> float:
    """Depth of the part, 0 to 1, at a time."""
    if t < start:
        return 0.0
    for press in presses:
        for length, depth in (
            (press.ramp_s, lambda x: x),
            (press.hold_s, lambda x: 1.0),
            (press.ramp_s, lambda x: 1.0 - x),
            (press.free_s, lambda x: 0.0),
        ):
            if t < start + length:
                return depth((t - start) / length)
            start += length
    return 0.0


@settings(max_examples=150, deadline=None)
@given(
    fps=st.floats(5, 60),
    presses=st.lists(
        st.builds(Press, st.floats(0.05, 0.6), st.floats(1.4, 3.0), st.floats(1.0, 6.0)),
        min_size=1,
        max_size=4,
    ),
    seed=st.integers(0, 2**32 - 1),
    drop=st.floats(0.0, 0.25),
    noise=st.floats(0.0, 0.0015),
)
def test_each_press_is_settled_once_at_any_frame_rate(
    fps: float, presses: list[Press], seed: int, drop: float, noise: float
) -> None:
    """5 to 60 frames a second with jitter, drops and noise: one settled frame per press, taken during its hold."""
    rng = random.Random(seed)
    track, events = free(), list[Event]()
    times: dict[int, float] = {}
    clock, last, end = 0.0, 0.0, 1.0 + sum(2 * p.ramp_s + p.hold_s + p.free_s for p in presses)
    was_dropped = False
    sequence = 0
    while clock < end:
        clock += rng.uniform(0.7, 1.3) / fps
        sequence += 1
        was_dropped = not was_dropped and rng.random() < drop
        if was_dropped:
            continue
        depth = depth_at(clock, presses, 1.0)

        anchor = track.window.anchor(round(clock * 1e9), RULES)
        rested = times[anchor.sequence] if anchor else -1.0

        def changed(earlier: float, depth: float = depth) -> float:
            moved = 0.1 * abs(depth - depth_at(earlier, presses, 1.0))
            return min(1.0, moved + rng.uniform(0, noise))

        area = 0.1 * depth + rng.uniform(0, noise)
        frame = replace(
            Observation(round(clock * 1e9), sequence, Touch(area), changed(rested), changed(last)),
            strength=10 * depth,
        )
        track, new = step(track, frame, RULES)
        last, times[sequence] = clock, clock
        events += new
    check_grammar(events)
    settled = [e for e in events if isinstance(e, PressSettled)]
    assert len(settled) == len(presses)
    assert sum(isinstance(e, PressBegan) for e in events) == len(presses)
    for event in settled:
        assert depth_at(times[event.sequence], presses, 1.0) > 0.9


def test_settings_refuse_nonsense() -> None:
    """Levels that cross, shares beyond 1, times that run backwards."""
    for make in (
        lambda: ContactSettings(on_area=0.001),
        lambda: ContactSettings(still_share=1.5),
        lambda: ContactSettings(onset_s=-1),
        lambda: ContactSettings(settle_timeout_s=0.1),
        lambda: ContactSettings(min_frames=0),
    ):
        with pytest.raises(ValueError, match="found"):
            make()
