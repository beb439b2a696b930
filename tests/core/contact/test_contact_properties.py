"""What holds for every press, whatever happens and at any frame rate."""

import random
from collections.abc import Iterable
from dataclasses import dataclass, replace

from contact_frames import FAINT, FREE, MS, PRESSED, RULES, free
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.contact.events import (
    Event,
    PressBegan,
    PressEnded,
    PressNotSettled,
    PressSettled,
)
from edge.core.contact.mask import Touch
from edge.core.contact.rules import gap, relearn, step, trigger
from edge.core.contact.settings import ContactSettings
from edge.core.contact.settled_frame import Observation
from edge.core.contact.signals import Track
from edge.core.contact.table import State


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


@settings(max_examples=150, deadline=None)
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


@settings(max_examples=60, deadline=None)
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
