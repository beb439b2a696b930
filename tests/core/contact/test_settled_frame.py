"""When a press rests, and which of its frames is scored."""

import math
from dataclasses import replace

import numpy as np
import pytest
from contact_frames import FREE, HELD, MS, PRESS, RELEASED, RULES, at, free, pressed, run, seen, story

from edge.core.contact.events import PressSettled
from edge.core.contact.rules import trigger
from edge.core.contact.settled_frame import Observation, Window
from edge.core.contact.table import State


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


@pytest.mark.parametrize("fps", [15.0, 18.75, 25.0, 30.0, 60.0])
@pytest.mark.parametrize("ramp_ms", [40, 300, 1000, 2000])
def test_the_frame_that_is_scored_is_foreseen(fps: float, ramp_ms: float) -> None:
    """While a press settles it is named once, and hardly another one."""
    frames = [replace(frame, motion=0.001) for frame in ramped(1000 / fps, ramp_ms, 800)]
    foreseen, track = list[int](), free()
    for seen_now in frames:
        track, events = run(track, [seen_now])
        if chosen := [e.sequence for e in events if isinstance(e, PressSettled)]:
            break
        probable = track.window.foresee(0, RULES) if track.state is State.SETTLING else None
        if probable is not None and probable.sequence not in foreseen:
            foreseen.append(probable.sequence)
    assert chosen[0] in foreseen
    assert len(foreseen) <= 3


def test_texture_that_deepens_is_growth() -> None:
    """The outline of a soft part may rest while its texture still sinks in."""
    frames = [replace(pressed(40 + 40 * k, 10.0), texture=0.2 * min(k, 20)) for k in range(40)]
    _, events = run(free(), frames)
    [decided] = [e for e in events if isinstance(e, PressSettled)]
    assert decided.sequence >= 40 + 40 * 18


def test_the_deepest_frame_at_rest_is_scored() -> None:
    """A hand trembles: the frames at rest differ in depth. Of those as deep, the stillest; of equals the later."""
    depths = [10.0, 9.5, 10.25, 9.6, 9.9, 9.8]
    frames = [pressed(40 + k * 40, depth) for k, depth in enumerate(depths)]
    _, events = run(free(), frames)
    assert [e.sequence for e in events if isinstance(e, PressSettled)] == [120]
    motions = [0.9, 0.05, 0.01, 0.03, 0.01, 0.03]
    level = [pressed(40 + k * 40, 10.0, motion) for k, motion in enumerate(motions)]
    _, events = run(free(), level)
    assert [e.sequence for e in events if isinstance(e, PressSettled)] == [200]


def test_a_slide_is_no_rest() -> None:
    """More than a fifth of the touched pixels have changed in 0.2 s, though the depth is the same."""
    frames = [pressed(40 + 40 * k, 10.0, change=0.021 if k < 40 else 0.019) for k in range(50)]
    _, events = run(free(), frames)
    [decided] = [e for e in events if isinstance(e, PressSettled)]
    assert decided.timestamp_ns == (40 + 40 * 40) * MS


def grasped(fps: float, length_ms: float, phase: float) -> list[Observation]:
    """A grasp without a plateau: half a sine, 10 at its middle, then the free gel. phase: of the first frame."""
    times = [(k + phase) * 1000 / fps for k in range(1, int((length_ms + 2000) * fps / 1000))]
    depths = [10 * math.sin(math.pi * min(t / length_ms, 1)) for t in times]
    frames = [
        pressed(40 + t, depth) if depth > 0.1 else seen(40 + t, FREE)
        for t, depth in zip(times, depths, strict=True)
    ]
    return [replace(frame, sequence=number) for number, frame in enumerate(frames)]


@pytest.mark.parametrize("fps", [5.0, 10.0, 15.0, 18.75, 25.0, 30.0, 60.0])
@pytest.mark.parametrize("length_ms", [400, 500, 700, 1000])
def test_a_grasp_that_never_rests_is_judged_at_its_peak(fps: float, length_ms: float) -> None:
    """At 95 % of its depth and more, or not at all; at the sensor's own rates always."""
    for phase in np.linspace(0, 1, 8, endpoint=False):
        frames = grasped(fps, length_ms, phase)
        _, events = run(free(), frames)
        chosen = [frames[event.sequence].strength for event in events if isinstance(event, PressSettled)]
        assert all(depth >= 9.5 for depth in chosen)
        assert len(chosen) == 1 or fps < 18


def test_a_peak_before_its_trigger_is_not_scored() -> None:
    """The trigger asks for a verdict while the part is lifted: there is no frame of full depth since then."""
    frames = grasped(30.0, 600, 0.0)
    track, before = run(free(), frames[:14], replace(RULES, is_external=True))
    track, _ = trigger(track)
    _, after = run(track, frames[14:], replace(RULES, is_external=True))
    assert story(before + after) == RELEASED
    track, before = run(free(), frames[:5], replace(RULES, is_external=True))
    track, _ = trigger(track)
    _, after = run(track, frames[5:], replace(RULES, is_external=True))
    assert story(before + after) == PRESS


def test_rest_after_the_peak_scores_the_peak() -> None:
    """A grip that gives way: 10 for a moment, then 8 at rest."""
    depths = [4, 8, 10, 10, 10, 9.5, 9, 8.5, *[8] * 12]
    _, events = run(free(), [pressed(40 + k * 40, depth) for k, depth in enumerate(depths)])
    assert [event.sequence for event in events if isinstance(event, PressSettled)] == [200]


def slid(spacing_ms: int) -> list[Observation]:
    """A press of even depth that changes a quarter of what it touches from frame to frame."""
    frames = [pressed(40 + spacing_ms * k, 10.0, motion=0.025, change=0.025) for k in range(20)]
    return [*frames, *at(40 + spacing_ms * 20, [FREE] * 5)]


LIFTED = [pressed(1040 + k * 40, 10.0 * (1 - k / 25)) for k in range(1, 20)]
BLURRED = ((6, 0.01), (8, 0.01), (9.2, 0.01), (9.2, 0.01), (10, 0.05), (8, 0.01), (6, 0.01))
RAMPS = {
    "lifted while it deepens": ([*ramped(40, 320, 0), *at(400, [FREE] * 5)], RELEASED),
    "slowly up again at once": ([*ramped(40, 1000, 0), *LIFTED, *at(1900, [FREE] * 5)], PRESS),
    "straddled at 5 frames a second": (
        [pressed(200, 3.0), pressed(400, 6.7), pressed(600, 6.7), *at(800, [FREE] * 5, spacing_ms=200)],
        RELEASED,
    ),
    "its deepest frame is blurred": (
        [*(pressed(40 + 40 * k, d, m) for k, (d, m) in enumerate(BLURRED)), *at(400, [FREE] * 5)],
        PRESS,
    ),
    "slid all the time": (slid(40), RELEASED),
    "six seconds down, for the timeout runs from the last growth": (ramped(40, 6000, 600), HELD),
}


@pytest.mark.parametrize("name", RAMPS)
def test_a_press_settles_where_it_rests(name: str) -> None:
    """One that never rested is counted, and rejected."""
    frames, expected = RAMPS[name]
    assert story(run(free(), frames)[1]) == expected


def test_a_press_without_frames_does_not_rest() -> None:
    assert not Window().is_at_rest(RULES)
