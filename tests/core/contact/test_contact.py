"""The contact table, and what a press goes through, on numbers alone."""

from dataclasses import replace

import pytest
from contact_frames import (
    FAINT,
    FREE,
    HELD,
    MS,
    PRESS,
    PRESSED,
    RELEASED,
    RULES,
    at,
    free,
    run,
    seen,
    story,
    unconfirmed,
)

from edge.core.contact.events import (
    PressBegan,
    PressNotSettled,
    PressSettled,
    ReferenceReady,
    TriggerRepeated,
    TriggerWithoutContact,
)
from edge.core.contact.rules import gap, relearn, step, trigger
from edge.core.contact.settings import ContactSettings
from edge.core.contact.settled_frame import Observation
from edge.core.contact.signals import Track, is_touch, phase_of
from edge.core.contact.table import TABLE, Signal, State, table_markdown

EXTERNAL = ContactSettings(is_external=True)


def light(at_ms: float, relief: float, area: float = 0.0) -> Observation:
    return replace(seen(at_ms, area), relief=relief, texture=20 * relief)


def inverse(at_ms: float, area: float = PRESSED, imprint: float = -2.0) -> Observation:
    return replace(seen(at_ms, area), imprint=imprint, strength=10.0)


def deep(start_ms: int, strengths: list[float], change: float = 0.0) -> list[Observation]:
    """Frames that all touch the same area, with these strengths."""
    frames = at(start_ms, [PRESSED] * len(strengths), change=change)
    return [replace(frame, strength=value) for frame, value in zip(frames, strengths, strict=True)]


def test_every_state_handles_every_signal() -> None:
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
    assert all(TABLE[state, Signal.BLIND] is state for state in State)


def springing(relief: float, strength: float) -> list[Observation]:
    """A press of 10 is released, and 0.12 s later this shows for a second, then nothing."""
    shown = (
        [(0.1, 0.1, 10.0)] * 12
        + [(0.0, 0.02, 0.0)] * 6
        + [(0.0, relief, strength)] * 25
        + [(0.0, 0.0, 0.0)] * 10
    )
    return [
        replace(seen(40 + 40 * k, area), relief=relief, strength=strength, texture=relief)
        for k, (area, relief, strength) in enumerate(shown)
    ]


STORIES = {
    "one frame is no press": (at(40, [FREE, PRESSED, FREE, PRESSED, FREE]), ""),
    "less than the onset time is no press": (at(40, [PRESSED] * 5 + [FREE] * 20, spacing_ms=10), ""),
    "a clear frame is no release": (at(40, ([PRESSED] * 10 + [FREE]) * 2 + [FREE] + [PRESSED] * 10), HELD),
    "between the levels none begins": (at(40, [FAINT] * 50), ""),
    "between the levels none ends": (at(40, [PRESSED] * 10 + [FAINT] * 50), HELD),
    "a tap": (at(40, [PRESSED] * 5, change=0.5) + at(240, [FREE] * 5), RELEASED),
    "texture before area": ([light(40 * k, 0.03 if 5 <= k < 20 else 0.0) for k in range(1, 30)], PRESS),
    "a fingertip rolls, then holds lightly": (deep(40, [10] * 10 + [2] * 5 + [10] * 10 + [5] * 50), HELD),
    "the residue of one that never rested": (deep(40, [10] * 8, 0.5) + deep(360, [3] * 40), RELEASED),
    "a soft part springs back": (springing(0.05, 0.5), PRESS),
    "another one just after it": (springing(0.12, 6.0), f"{PRESS} {PRESS}"),
    "one more during recovery": (at(40, ([PRESSED] * 10 + [FREE] * 4) * 2), f"{PRESS} {PRESS}"),
}


@pytest.mark.parametrize("name", STORIES)
def test_what_frames_tell(name: str) -> None:
    frames, expected = STORIES[name]
    assert story(run(free(), frames)[1]) == expected


@pytest.mark.parametrize(("moved", "last"), [(None, 1), (18, 18)])
def test_a_still_start_learns_a_reference(moved: int | None, last: int) -> None:
    """Half a second of warm-up, then ten still frames; a change in the middle starts the warm-up again."""
    track, events = run(Track(), [seen(i * 40, None, change=0.2 * (i == moved)) for i in range(1, 60)])
    assert events == [ReferenceReady((last + 13 + 9) * 40 * MS)]
    assert track.state is State.NO_CONTACT


def test_black_frames_at_the_start_are_not_learnt() -> None:
    track, events = run(Track(), (replace(seen(i * 40, None), is_black=True) for i in range(1, 100)))
    assert (track.state, events) == (State.WARM_UP, [])


def test_a_part_that_was_there_at_the_start_is_not_a_press() -> None:
    """Against a stored reference it is noticed, never counted, and its lift makes the sensor ready."""
    track, events = run(Track(), (seen(i * 40, PRESSED) for i in range(1, 60)))
    assert (story(events), track.state) == ("StartedTouched", State.CONTACT)
    track, events = run(track, at(60 * 40, [FREE] * 10))
    assert (story(events), track.state) == ("ReferenceReady", State.RECOVERY)


def test_one_press() -> None:
    track, events = run(free(), at(40, [FREE] * 5 + [PRESSED] * 20 + [FREE] * 10))
    assert (story(events), track.state) == (PRESS, State.RECOVERY)
    assert [event.touch.area for event in events if isinstance(event, PressSettled)] == [PRESSED]


def test_a_press_that_never_rests_is_not_settled_in_time() -> None:
    """Three seconds after its imprint last grew it is rejected, once; rest that comes later is too late."""
    frames = at(40, [PRESSED] * 100, change=0.5) + at(4040, [PRESSED] * 50) + at(6040, [FREE] * 5)
    _, events = run(free(), frames)
    assert story(events) == "PressBegan PressNotSettled:TIMED_OUT PressEnded"
    [late] = [event for event in events if isinstance(event, PressNotSettled)]
    assert 3_000 * MS <= late.timestamp_ns - late.began_ns <= 3_200 * MS


def test_relief_that_stays_after_a_press_is_no_press() -> None:
    """An imprint stays in relief for seconds: it neither holds a press open that had an area, nor begins one."""
    heavy = [light(40 * k, 0.2, 0.1) for k in range(1, 20)]
    left = [light(800 + 40 * k, 0.05 + 0.002 * (k % 2)) for k in range(50)]
    track, events = run(free(), [*heavy, *left])
    assert story(events) == PRESS
    assert story(run(track, [light(2800 + 40 * k, 0.09) for k in range(20)])[1]) == HELD


def test_a_lift_from_a_pressed_reference_is_no_press() -> None:
    """It has lost structure that the reference shows: doubted at once, corrected at rest, and nothing is counted."""
    track, events = run(unconfirmed(), [*(inverse(40 * k) for k in range(1, 7)), *at(280, [FREE] * 20)])
    assert story(events) == "ReferenceDoubted ReferenceCorrected ReferenceReady"
    assert (track.state, track.is_confirmed) == (State.RECOVERY, False)
    later = [*(inverse(40 * k, imprint=0.0) for k in range(1, 5)), *(inverse(40 * k) for k in range(5, 20))]
    track, events = run(unconfirmed(), [*later, *at(800, [FREE] * 20)])
    assert story(events).startswith("PressBegan PressNotSettled:DOUBTED PressEnded")
    assert track.state is State.RECOVERY
    assert story(run(track, deep(1640, [0.9] * 10))[1]) == HELD, (
        "a light press is no rest of what was in doubt"
    )


def test_what_no_press_decides_several_do() -> None:
    """Each takes a little structure: the third is doubted. Where each adds a little, the reference is confirmed."""
    presses = [
        replace(frame, imprint=-0.3, strength=10.0) if frame.area else frame
        for frame in at(40, ([PRESSED] * 10 + [FREE] * 5) * 3)
    ]
    assert story(run(unconfirmed(), presses)[1]).startswith(f"{PRESS} {PRESS} ReferenceDoubted")
    added = [replace(frame, imprint=-frame.imprint) for frame in presses]
    track, events = run(unconfirmed(), added)
    assert (story(events), track.is_confirmed) == (f"{PRESS} {PRESS} {PRESS}", True)


def test_a_confirmed_reference_is_not_doubted() -> None:
    """Once a press has added structure and gone, a press that looks inverse is a press."""
    press = [inverse(40 * k, imprint=2.0) for k in range(1, 20)]
    track, events = run(unconfirmed(), [*press, *at(800, [FREE] * 5)])
    assert story(events) == PRESS
    assert story(run(track, (inverse(1000 + 40 * k) for k in range(1, 20)))[1]) == HELD


def test_a_free_gel_that_never_rests_is_no_peak() -> None:
    """The reference was a pressed gel: what looks deepest for a moment is the free gel, and is not scored."""
    lift = [*deep(40, [5] * 4), *(inverse(200 + 40 * k) for k in range(3)), *at(320, [FREE] * 5)]
    assert story(run(unconfirmed(), lift)[1]) == RELEASED


def test_doubt_ends_where_the_reference_is_seen_again() -> None:
    """The part comes down again before its lift was at rest: back to no contact, and doubted at the next lift."""
    moving = [replace(inverse(40 * k), change=0.5) for k in range(1, 8)]
    track, events = run(unconfirmed(), [*moving, *at(320, [FREE] * 5)])
    assert (story(events), track.state) == ("ReferenceDoubted ReferenceReady", State.NO_CONTACT)
    assert story(run(track, (inverse(520 + 40 * k) for k in range(8)))[1]).startswith("ReferenceDoubted")


@pytest.mark.parametrize("change", [0.0, 0.5], ids=["corrected", "seen again"])
def test_after_a_doubt_the_gel_is_seen_and_nothing_is_wanted(change: float) -> None:
    """Also where the doubt was of what touched at the start: until the next press nobody would say that the gel is
    free. The new reference is doubted as the first one was. And a verdict that was wanted of what was doubted is none
    of the next press."""
    touched, _ = run(Track(), (seen(i * 40, PRESSED) for i in range(1, 60)))
    lifted = [replace(inverse(2400 + 40 * k), change=change) for k in range(8)]
    track, events = run(touched, [*lifted, *at(2720, [FREE] * 10)])
    assert "ReferenceReady" in story(events)
    assert phase_of(track, seen(3080, FREE), RULES) == "free"
    again = (inverse(3120 + 40 * k, imprint=-0.8) for k in range(8))
    assert story(run(track, again)[1]).startswith("ReferenceDoubted")
    wanted = replace(unconfirmed(), state=State.CONTACT, is_wanted=True)
    track, events = run(wanted, [*lifted, *at(2720, [FREE] * 10)], EXTERNAL)
    assert "ReferenceReady" in story(events)
    _, events = run(track, at(3120, [PRESSED] * 20 + [FREE] * 10), EXTERNAL)
    assert story(events) == "PressBegan PressNotSettled:NOT_TRIGGERED PressEnded"


def test_a_first_press_that_never_ends_is_doubted() -> None:
    """Half a minute without structure added, and no press before it: the reference was no free gel."""
    frames = [replace(seen(100 * k, PRESSED), imprint=0.1, strength=10.0) for k in range(1, 400)]
    _, events = run(unconfirmed(), frames)
    assert story(events).startswith(f"{PRESS} ReferenceDoubted ReferenceCorrected")
    assert story(run(unconfirmed(), [replace(frame, imprint=1.0) for frame in frames])[1]) == HELD


RESIDUES = {
    "3 % of the view after 80 %": (at(40, [0.8] * 10 + [0.03] * 100 + [0.035] * 10 + [0.06] * 10), HELD, 120),
    "a third as strong": (deep(40, [10] * 10 + [3.3] * 12 + [4] * 10 + [10] * 10 + [1] * 12), PRESS, 32),
}


@pytest.mark.parametrize("name", RESIDUES)
def test_residue_neither_holds_a_press_open_nor_begins_one(name: str) -> None:
    """What stays is a release; only more than it is a press again, which begins with this frame or later."""
    frames, again, begins = RESIDUES[name]
    _, events = run(free(), frames)
    assert story(events) == f"{PRESS} {again}"
    assert [event.timestamp_ns for event in events if isinstance(event, PressBegan)][1] >= (
        40 + begins * 40
    ) * MS


@pytest.mark.parametrize(("relief", "is_press"), [(0.033, False), (0.035, True)])
def test_relief_that_a_press_has_left_begins_no_other(relief: float, is_press: bool) -> None:
    """It fades for seconds: a press is a hundredth of the view more than a fifth above it."""
    left = replace(free(), relief_residue=0.02)
    assert is_touch(left, light(40, relief), RULES) == is_press


def test_time_must_rise() -> None:
    track, _ = step(free(), seen(40, FREE), RULES)
    with pytest.raises(ValueError, match="rise"):
        step(track, seen(40, FREE), RULES)


def test_a_gap_in_a_settled_press_does_not_count_it_again() -> None:
    """Unplugged while the part presses, plugged in with the part still there: one press."""
    track, events = run(free(), at(40, [PRESSED] * 10))
    assert story(events) == HELD
    for start in (5_000, 20_000):
        track, new = gap(track)
        track, later = run(track, at(start, [PRESSED] * 50))
        assert [*new, *later] == []
    assert story(run(track, at(40_000, [FREE] * 5))[1]) == "PressEnded"


MOVING, STILL = at(40, [PRESSED] * 5, change=0.5), at(40, [PRESSED] * 10)
GAPS = {
    "a settled press is lifted": (STILL, at(5_000, [FREE] * 30), "PressEnded"),
    "a deeper one is held lightly, and lifted": (
        deep(40, [10] * 5, change=0.5),
        [*deep(5_000, [6] * 9), *at(5_360, [FREE] * 30)],
        "PressNotSettled:RELEASED PressEnded",
    ),
    "another one is lifted": (MOVING, at(5_000, [FREE] * 30), "PressNotSettled:RELEASED PressEnded"),
    "the timeout does not run": (MOVING, at(60_000, [PRESSED] * 30), "PressSettled"),
    "the exposure needs 0.3 s, no press": ([], at(1_000, [0.9] * 7 + [FREE] * 20), ""),
    "the exposure needs 0.3 s, no release": (STILL, at(1_000, [FREE] * 7 + [PRESSED] * 20), ""),
}


@pytest.mark.parametrize("name", GAPS)
def test_what_is_told_after_a_gap(name: str) -> None:
    """Each press gets its one verdict event and its end."""
    before, after, expected = GAPS[name]
    track, _ = gap(run(free(), before)[0])
    assert story(run(track, after)[1]) == expected


def test_a_trigger_without_contact_says_so() -> None:
    for state in (State.WARM_UP, State.BASELINE, State.NO_CONTACT, State.RECOVERY):
        assert trigger(Track(state=state))[1] == (TriggerWithoutContact(state),)


def test_external_presses_wait_for_their_trigger() -> None:
    """Still for a second, no event; at the trigger the next frame is scored, once."""
    track, events = run(free(), at(40, [PRESSED] * 25), EXTERNAL)
    track, new = trigger(track)
    assert (story(events), new) == ("PressBegan", ())
    track, events = run(track, at(1040, [PRESSED] * 5), EXTERNAL)
    assert story(events) == "PressSettled"
    assert [e.sequence for e in events if isinstance(e, PressSettled)] == [1040]
    assert trigger(track)[1] == (TriggerRepeated(State.CONTACT),)


def test_the_newest_trigger_says_from_when_on_a_frame_is_scored() -> None:
    """Of one that was given up, and of one by a pedal, a PLC would get an older picture than its own trigger."""
    track, _ = run(free(), at(40, [PRESSED] * 2), EXTERNAL)
    track, _ = run(trigger(track)[0], at(120, [PRESSED] * 2), EXTERNAL)
    _, events = run(trigger(track)[0], at(200, [PRESSED] * 10), EXTERNAL)
    assert [event.sequence >= 200 for event in events if isinstance(event, PressSettled)] == [True]


def test_external_press_without_a_trigger_is_counted_but_not_scored() -> None:
    _, events = run(free(), at(40, [PRESSED] * 200 + [FREE] * 5), EXTERNAL)
    assert story(events) == "PressBegan PressNotSettled:NOT_TRIGGERED PressEnded"


def test_a_trigger_during_the_approach_is_kept_or_answered() -> None:
    """It arms the next press; if no press follows, an event says so."""
    armed, _ = trigger(run(free(), at(40, [PRESSED]), EXTERNAL)[0])
    assert story(run(armed, at(80, [PRESSED] * 10), EXTERNAL)[1]) == HELD
    assert story(run(armed, at(80, [FREE] * 10), EXTERNAL)[1]) == "TriggerWithoutContact"
    assert story(gap(armed)[1]) == "TriggerWithoutContact"


def test_relearning_closes_a_press() -> None:
    for frames, expected in ((MOVING, "PressNotSettled:RELEARNT PressEnded"), (STILL, "PressEnded")):
        track, events = relearn(run(free(), frames)[0])
        assert (story(events), track.state) == (expected, State.WARM_UP)


def test_the_table_that_the_manual_prints_says_where_each_signal_leads() -> None:
    """A dot where the state stays."""
    heads, rule, *rows = table_markdown().splitlines()
    assert heads == "| state | " + " | ".join(Signal) + " |"
    assert rule == "|---|" + "---|" * len(Signal)
    assert len(rows) == len(State)
    cells = ["·", "·", "·", "·", "approach", "·", "·", "·", "·", "·", "·", "warm-up"]
    assert rows[2] == f"| **no contact** | {' | '.join(cells)} |"
