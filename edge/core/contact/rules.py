"""Contact: the rules that turn one frame's numbers into one signal of the table, and the events that follow.

All times are in seconds of the frames' own timestamps, so that a press gives the same events at 5 and at 60 frames a
second. Two rules always hold. A press that began gives exactly one of `PressSettled` and `PressNotSettled`, and then
one `PressEnded`. A press lasts until the gel has been seen free, so a gap in the stream (unplugged, stalled) never
makes two presses out of one. A lift and a new press completely inside a gap cannot be distinguished from one long
press, and count as one.
"""

from dataclasses import replace

from edge.core.contact.events import (
    Event,
    NotSettledReason,
    PressBegan,
    PressEnded,
    PressNotSettled,
    PressSettled,
    ReferenceCorrected,
    ReferenceDoubted,
    ReferenceReady,
    StartedTouched,
    TriggerRepeated,
    TriggerWithoutContact,
)
from edge.core.contact.settings import ContactSettings
from edge.core.contact.settled_frame import Observation, Window, is_moving
from edge.core.contact.signals import (
    ADDS_STRUCTURE,
    IDLE,
    LEARNING,
    PRESSED,
    RESIDUE_SHARE,
    UNJUDGED,
    WATCHED,
    Track,
    is_touch,
    level_of,
    signal_of,
)
from edge.core.contact.table import TABLE, Signal, State

__all__ = ["gap", "relearn", "step", "trigger"]


def step(track: Track, seen: Observation, settings: ContactSettings) -> tuple[Track, tuple[Event, ...]]:
    """Take one frame. Errors: ValueError for a timestamp that does not rise: no frame is processed twice."""
    if track.last_ns is not None and seen.timestamp_ns <= track.last_ns:
        raise ValueError(f"timestamps rise, found {seen.timestamp_ns} after {track.last_ns}")
    track = _resumed(replace(track, last_ns=seen.timestamp_ns), seen, settings)
    if seen.is_black or seen.timestamp_ns < track.blind_until_ns:
        return replace(track, state=TABLE[track.state, Signal.BLIND]), ()
    track = _measure(_update_rest(track, seen, settings), seen, settings)
    track = _watched(track, seen, settings)
    return _transition(track, signal_of(track, seen, settings), seen, settings)


def gap(track: Track) -> tuple[Track, tuple[Event, ...]]:
    """The stream was interrupted. A press continues; an unconfirmed state starts again."""
    state = TABLE[track.state, Signal.GAP]
    lost = track.state is State.APPROACH and track.is_wanted
    events = (TriggerWithoutContact(track.state),) if lost else ()
    return replace(
        track,
        state=state,
        frames=0 if state is State.WARM_UP else track.frames,
        still_frames=0,
        window=Window(),
        is_wanted=track.is_wanted and not lost,
        is_interrupted=True,
    ), events


def trigger(track: Track) -> tuple[Track, tuple[Event, ...]]:
    """A verdict is requested now: the first still frame from here on is scored, if something presses."""
    if track.state is State.APPROACH or track.state in UNJUDGED:
        return replace(track, is_wanted=True, wanted_ns=(track.last_ns or 0) + 1), ()
    if track.state in PRESSED:
        return track, (TriggerRepeated(track.state),)
    return track, (TriggerWithoutContact(track.state),)


def relearn(track: Track) -> tuple[Track, tuple[Event, ...]]:
    """A new reference is requested, as after a change of gel: start again, closing a press that is in progress."""
    now = track.last_ns or 0
    sequence = track.window.frames[-1].sequence if track.window.frames else 0
    events = _closed(track, now, sequence, NotSettledReason.RELEARNT)
    return Track(state=TABLE[track.state, Signal.RELEARN], last_ns=track.last_ns), events


def _resumed(track: Track, seen: Observation, settings: ContactSettings) -> Track:
    """The first frame after a gap: the exposure needs a moment, and clocks that ran during the gap start again."""
    if not track.is_interrupted:
        return track
    sighted_ns = seen.timestamp_ns + round(settings.resume_s * 1e9)
    return replace(track, is_interrupted=False, blind_until_ns=sighted_ns, wanted_ns=sighted_ns)


def _update_rest(track: Track, seen: Observation, settings: ContactSettings) -> Track:
    """Keep the run of still frames that a reference may be learnt from."""
    if track.state not in LEARNING:
        return track
    if track.still_frames == 0 or is_moving(seen, settings):
        return replace(track, still_ns=seen.timestamp_ns, still_frames=1)
    return replace(track, still_frames=track.still_frames + 1)


def _watched(track: Track, seen: Observation, settings: ContactSettings) -> Track:
    """Keep the frames that a verdict may be given on; a press that deepens still has all its time."""
    if track.state not in WATCHED and not (
        track.state in IDLE and level_of(track, seen, settings) is Signal.TOUCH
    ):
        return replace(track, window=Window()) if track.window.frames else track
    window = track.window.after(seen, settings)
    grown_ns = seen.timestamp_ns if window.is_growing(settings) else track.grown_ns
    return replace(track, window=window, grown_ns=grown_ns)


def _measure(track: Track, seen: Observation, settings: ContactSettings) -> Track:
    """The press's largest area and relief, and the last one's residue, which only shrinks."""
    if track.state in PRESSED:
        strength_peak = max(track.strength_peak, seen.strength)
        sunk_ns = seen.timestamp_ns if track.sunk_ns is None else track.sunk_ns
        return replace(
            track,
            peak=max(track.peak, seen.area),
            relief_peak=max(track.relief_peak, seen.relief),
            strength_peak=strength_peak,
            sunk_ns=sunk_ns if seen.strength < RESIDUE_SHARE * strength_peak else None,
        )
    return replace(
        track,
        touched_ns=seen.timestamp_ns if is_touch(track, seen, settings) else track.touched_ns,
        residue=min(track.residue, seen.area),
        relief_residue=min(track.relief_residue, seen.relief),
        strength_residue=min(track.strength_residue, seen.strength),
    )


def _transition(
    track: Track, signal: Signal, seen: Observation, settings: ContactSettings
) -> tuple[Track, tuple[Event, ...]]:
    """Take the table's move; a change of state restarts the state's clock and may give events."""
    state = TABLE[track.state, signal]
    if state is track.state:
        first_ns = track.since_ns if track.frames else seen.timestamp_ns
        return replace(track, frames=track.frames + 1, since_ns=first_ns), ()
    events = _events_for(track, signal, state, seen, settings)
    return _entered(
        replace(track, state=state, since_ns=seen.timestamp_ns, frames=1), track, seen, settings
    ), events


def _entered(track: Track, before: Track, seen: Observation, settings: ContactSettings) -> Track:
    """The values at the start of a state."""
    match before.state, track.state:
        case State.BASELINE, State.NO_CONTACT:
            return replace(track, is_confirmed=seen.touch is not None)
        case State.APPROACH, State.SETTLING:
            return replace(
                _start_press(track, seen),
                is_counted=True,
                is_wanted=track.is_wanted or not settings.is_external,
                wanted_ns=track.wanted_ns if track.is_wanted else 0,
            )
        case State.BASELINE, State.CONTACT:
            return replace(_start_press(track, seen), is_counted=False)
        case State.SETTLING, State.CONTACT:
            return replace(
                track,
                imprint=seen.imprint,
                decided_area=track.peak,
                decided_strength=track.strength_peak,
            )
        case State.DOUBT, State.RECOVERY:
            return replace(
                track,
                residue=0.0,
                relief_residue=0.0,
                strength_residue=0.0,
                strength_peak=0.0,  # what was in doubt was no press whose rest may show
                earlier_imprints=0.0,
                is_confirmed=False,
                is_cycled=False,
            )
        case _, State.RECOVERY:
            return _over(track, before, seen)
        case State.APPROACH, State.NO_CONTACT:
            return replace(track, is_wanted=False)
        case _, State.DOUBT:  # it is no press any more, and what comes is another one
            return replace(track, is_wanted=False, is_counted=True)
    return track


def _start_press(track: Track, seen: Observation) -> Track:
    return replace(
        track,
        began_ns=seen.timestamp_ns,
        grown_ns=seen.timestamp_ns,
        peak=seen.area,
        relief_peak=seen.relief,
        strength_peak=seen.strength,
        sunk_ns=None,
        imprint=0.0,
    )


def _over(track: Track, before: Track, seen: Observation) -> Track:
    """A press is over: its residue, and what it shows about the reference."""
    is_whole = before.state is State.RELEASE
    imprints = track.earlier_imprints + track.imprint
    return replace(
        track,
        residue=seen.area,
        relief_residue=seen.relief,
        strength_residue=seen.strength,
        is_wanted=False,
        is_counted=True,
        is_cycled=track.is_cycled or (is_whole and before.is_counted),
        earlier_imprints=imprints,
        is_confirmed=track.is_confirmed
        or (is_whole and (imprints >= ADDS_STRUCTURE or not before.is_counted)),
    )


def _events_for(
    track: Track, signal: Signal, state: State, seen: Observation, settings: ContactSettings
) -> tuple[Event, ...]:
    now, sequence, began = seen.timestamp_ns, seen.sequence, track.began_ns
    match track.state, state:
        case State.BASELINE, State.NO_CONTACT:
            return (ReferenceReady(now),)
        case State.BASELINE, State.CONTACT:
            return (StartedTouched(now, seen.area),)
        case State.APPROACH, State.NO_CONTACT if track.is_wanted:
            return (TriggerWithoutContact(state),)
        case State.APPROACH, State.SETTLING:
            return (PressBegan(now, sequence),)
        case State.SETTLING, State.CONTACT if signal is Signal.STILL:
            return (_settle(track, track.window.choose(track.wanted_ns, settings), now),)
        case State.SETTLING, State.CONTACT:
            return (PressNotSettled(now, sequence, began, NotSettledReason.TIMED_OUT),)
        case State.EARLY_RELEASE, State.RECOVERY:
            ended = PressEnded(now, sequence, began)
            if not track.is_wanted:
                return PressNotSettled(now, sequence, began, NotSettledReason.NOT_TRIGGERED), ended
            peak = track.window.choose_peak(track.wanted_ns, track.strength_peak)
            if peak is not None:
                return replace(_settle(track, peak, now), is_held=False), ended
            return PressNotSettled(now, sequence, began, NotSettledReason.RELEASED), ended
        case State.RELEASE, State.RECOVERY:
            return (PressEnded(now, sequence, began),) if track.is_counted else (ReferenceReady(now),)
        case _, State.DOUBT:
            return (*_closed(track, now, sequence, NotSettledReason.DOUBTED), ReferenceDoubted(now))
        case State.DOUBT, State.RECOVERY:
            return ReferenceCorrected(now), ReferenceReady(now)
        case State.DOUBT, State.NO_CONTACT:
            return (ReferenceReady(now),)
    return ()


def _settle(track: Track, chosen: Observation, now: int) -> PressSettled:
    return PressSettled(now, chosen.sequence, track.began_ns, chosen.contact, chosen.strength)


def _closed(track: Track, now: int, sequence: int, reason: NotSettledReason) -> tuple[Event, ...]:
    """The events of a press that ends because the reference is discarded."""
    events: tuple[Event, ...] = ()
    if track.state in UNJUDGED:
        events += (PressNotSettled(now, sequence, track.began_ns, reason),)
    if track.state in PRESSED and track.is_counted:
        events += (PressEnded(now, sequence, track.began_ns),)
    return events
