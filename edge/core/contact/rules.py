"""Contact: the rules that turn one frame's numbers into one signal of the table, and the events that follow.

Everything is told in seconds of the frames' own timestamps, so that a press gives the same events at 5 and at 60
frames a second. Two rules hold whatever comes: a press that began gives exactly one of `PressSettled` and
`PressNotSettled`, and then one `PressEnded`; and a press lasts until the gel has been seen free, so a gap in the
stream (unplugged, stalled) never makes two presses out of one. A lift and a new press wholly inside a gap cannot be
told from one long press, and count as one.
"""

from dataclasses import dataclass, replace

from edge.core.contact.events import (
    Event,
    NotSettledReason,
    PressBegan,
    PressEnded,
    PressNotSettled,
    PressSettled,
    ReferenceReady,
    ReferenceRefreshed,
    StartedTouched,
    TriggerRepeated,
    TriggerWithoutContact,
)
from edge.core.contact.mask import Touch
from edge.core.contact.table import TABLE, Signal, State, table_markdown

__all__ = [
    "TABLE",
    "ContactSettings",
    "Event",
    "NotSettledReason",
    "Observation",
    "PressBegan",
    "PressEnded",
    "PressNotSettled",
    "PressSettled",
    "ReferenceReady",
    "ReferenceRefreshed",
    "Signal",
    "StartedTouched",
    "State",
    "Touch",
    "Track",
    "TriggerRepeated",
    "TriggerWithoutContact",
    "gap",
    "relearn",
    "step",
    "table_markdown",
    "trigger",
]

_UNJUDGED = frozenset({State.SETTLING, State.EARLY_RELEASE})
_PRESSED = _UNJUDGED | {State.CONTACT, State.RELEASE}


@dataclass(frozen=True)
class ContactSettings:
    """When a frame counts as touched, settled and released. Areas are fractions of the view, times seconds.

    is_external: presses are scored on a trigger (command, pedal) instead of by themselves.
    """

    # On 500-1,000 and off 100-200 of 76,800 pixels separated contact from residue on the maker's press video.
    on_area: float = 0.010
    off_area: float = 0.002
    # The imprint left after a release is 5 to 25 % of the signal for seconds; an area this small beside the press's
    # largest is a release, so that a hair or grease left behind cannot hold a press open.
    release_share: float = 0.05
    # Public tools confirm a contact over 2 to 5 frames at 25 to 30 frames a second.
    onset_s: float = 0.06
    release_s: float = 0.08
    # A view is still while fewer pixels than this share of the touched ones have changed since it came to rest.
    still_share: float = 0.20
    settle_s: float = 0.12
    settle_timeout_s: float = 3.0
    min_frames: int = 2
    settle_frames: int = 3
    # Cameras start black or at the wrong level: the SDKs throw 10 frames away.
    warm_up_s: float = 0.5
    resume_s: float = 0.3
    baseline_frames: int = 10
    # 5 to 19 % of the signal is still there 2 to 3 s after a release, so no reference is learnt before.
    recovery_s: float = 3.0
    refresh_s: float = 10.0
    refresh_weight: float = 0.3
    # Decoding is most of the cost of an idle gateway; looking ten times a second finds every press.
    idle_interval_s: float = 0.1
    is_external: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.off_area < self.on_area < 1:
            raise ValueError(
                f"0 < off_area < on_area < 1 is needed, found {self.off_area} and {self.on_area}"
            )
        shares = (self.release_share, self.still_share, self.refresh_weight)
        if not all(0 <= share < 1 for share in shares):
            raise ValueError(f"shares lie in [0, 1), found {shares}")
        times = (self.onset_s, self.release_s, self.settle_s, self.warm_up_s, self.resume_s, self.recovery_s)
        if min(*times, self.idle_interval_s) < 0 or not 0 <= self.settle_s < self.settle_timeout_s:
            raise ValueError(
                f"times are not negative and the settle timeout exceeds the settle time, found {self}"
            )
        if min(self.min_frames, self.settle_frames, self.baseline_frames) < 1 or self.refresh_s <= 0:
            raise ValueError(f"frame counts are at least 1 and the refresh time is positive, found {self}")


@dataclass(frozen=True)
class Observation:
    """One frame in numbers.

    touch: None while there is no reference to compare with. change: share of the view's pixels that differ from the
    view at rest, which is the frame of `Track.still_ns`. motion: the same against the frame before.
    """

    timestamp_ns: int
    sequence: int
    touch: Touch | None
    change: float
    motion: float
    is_black: bool = False


@dataclass(frozen=True)
class Track:
    """All that contact detection remembers between frames.

    since_ns, frames: when the present state began, and over how many frames. still_ns, still_frames: the same for
    the view at rest. candidate: the sequence that would be scored now, and its motion. wanted_ns: since when a verdict
    is wanted. peak: the largest area of this press. residue: the area that the last press left behind.
    is_counted: false for a part that was there at the start.
    """

    state: State = State.WARM_UP
    last_ns: int | None = None
    since_ns: int = 0
    frames: int = 0
    still_ns: int = 0
    still_frames: int = 0
    candidate: int | None = None
    candidate_motion: float = 1.0
    began_ns: int = 0
    is_wanted: bool = False
    wanted_ns: int = 0
    peak: float = 0.0
    residue: float = 0.0
    is_counted: bool = True
    is_interrupted: bool = False
    blind_until_ns: int = 0

    @property
    def has_contact(self) -> bool:
        """True from `PressBegan` to `PressEnded`, and for a part that was there at the start."""
        return self.state in _PRESSED


def step(track: Track, seen: Observation, settings: ContactSettings) -> tuple[Track, tuple[Event, ...]]:
    """One frame. Errors: ValueError for a timestamp that does not rise: no frame is looked at twice."""
    if track.last_ns is not None and seen.timestamp_ns <= track.last_ns:
        raise ValueError(f"timestamps rise, found {seen.timestamp_ns} after {track.last_ns}")
    track = _resumed(replace(track, last_ns=seen.timestamp_ns), seen, settings)
    if seen.is_black or seen.timestamp_ns < track.blind_until_ns:
        return replace(track, state=TABLE[track.state, Signal.BLIND]), ()
    track = _measured(_rested(track, seen, settings), seen)
    return _moved(track, _signal(track, seen, settings), seen, settings)


def gap(track: Track) -> tuple[Track, tuple[Event, ...]]:
    """The stream was interrupted. A press goes on where it was; what was not yet confirmed starts again."""
    state = TABLE[track.state, Signal.GAP]
    lost = track.state is State.APPROACH and track.is_wanted
    events = (TriggerWithoutContact(track.state),) if lost else ()
    return replace(
        track,
        state=state,
        frames=0 if state is State.WARM_UP else track.frames,
        still_frames=0,
        is_wanted=track.is_wanted and not lost,
        is_interrupted=True,
    ), events


def trigger(track: Track) -> tuple[Track, tuple[Event, ...]]:
    """A verdict is asked for now: the first still frame from here on is scored, if something presses."""
    if track.state is State.APPROACH or track.state in _UNJUDGED:
        if track.is_wanted:
            return track, ()
        return replace(track, is_wanted=True, wanted_ns=track.last_ns or 0, candidate_motion=1.0), ()
    if track.state in _PRESSED:
        return track, (TriggerRepeated(track.state),)
    return track, (TriggerWithoutContact(track.state),)


def relearn(track: Track) -> tuple[Track, tuple[Event, ...]]:
    """A new reference is asked for, as after a change of gel: start again, closing a press that is in progress."""
    now, sequence = track.last_ns or 0, track.candidate or 0
    events: tuple[Event, ...] = ()
    if track.state in _UNJUDGED:
        events += (PressNotSettled(now, sequence, track.began_ns, NotSettledReason.RELEARNT),)
    if track.state in _PRESSED and track.is_counted:
        events += (PressEnded(now, sequence, track.began_ns),)
    return Track(state=TABLE[track.state, Signal.RELEARN], last_ns=track.last_ns), events


def _seconds(later_ns: int, earlier_ns: int) -> float:
    return (later_ns - earlier_ns) / 1e9


def _resumed(track: Track, seen: Observation, settings: ContactSettings) -> Track:
    """The first frame after a gap: the exposure needs a moment, and clocks that ran during the gap start again."""
    if not track.is_interrupted:
        return track
    sighted_ns = seen.timestamp_ns + round(settings.resume_s * 1e9)
    return replace(track, is_interrupted=False, blind_until_ns=sighted_ns, wanted_ns=sighted_ns)


def _rested(track: Track, seen: Observation, settings: ContactSettings) -> Track:
    """Keep the still run, and the frame of it that moved least (the later one of equals)."""
    if track.still_frames == 0 or _is_moving(seen, settings):
        return replace(
            track, still_ns=seen.timestamp_ns, still_frames=1, candidate=seen.sequence, candidate_motion=1.0
        )
    track = replace(track, still_frames=track.still_frames + 1)
    if seen.motion > track.candidate_motion:
        return track
    return replace(track, candidate=seen.sequence, candidate_motion=seen.motion)


def _is_moving(seen: Observation, settings: ContactSettings) -> bool:
    """Without a reference a contact's worth of change is motion; with one, a share of what is touched."""
    if seen.touch is None:
        return seen.change > settings.on_area
    return seen.change > settings.still_share * max(seen.touch.area, settings.on_area)


def _measured(track: Track, seen: Observation) -> Track:
    """The press's largest area, and the last one's residue, which only shrinks."""
    area = _area(seen)
    if track.state in _PRESSED:
        return replace(track, peak=max(track.peak, area))
    return replace(track, residue=min(track.residue, area))


def _area(seen: Observation) -> float:
    return 0.0 if seen.touch is None else seen.touch.area


def _level(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    """Clear, faint or touch: hysteresis over what the last press left behind."""
    area = _area(seen)
    off = settings.off_area + track.residue
    if track.has_contact:
        off = max(off, settings.release_share * track.peak)
    if area <= off:
        return Signal.CLEAR
    return Signal.TOUCH if area >= settings.on_area + track.residue else Signal.FAINT


def _signal(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    match track.state:
        case State.WARM_UP | State.BASELINE:
            return _learning_signal(track, seen, settings)
        case State.SETTLING:
            return _settling_signal(track, seen, settings)
    level = _level(track, seen, settings)
    condition = {
        State.APPROACH: (Signal.TOUCH, settings.onset_s, settings.min_frames),
        State.EARLY_RELEASE: (Signal.CLEAR, settings.release_s, settings.min_frames),
        State.RELEASE: (Signal.CLEAR, settings.release_s, settings.min_frames),
        State.RECOVERY: (level if level is not Signal.TOUCH else None, settings.recovery_s, 1),
    }.get(track.state)
    if condition is None or level is not condition[0]:
        return level
    has_held = (
        _seconds(seen.timestamp_ns, track.since_ns) >= condition[1] and track.frames + 1 >= condition[2]
    )
    return Signal.ELAPSED if has_held else level


def _learning_signal(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    if track.still_ns == seen.timestamp_ns:
        return Signal.MOVING
    if track.state is State.WARM_UP:
        is_warm = _seconds(seen.timestamp_ns, track.since_ns) >= settings.warm_up_s
        return Signal.ELAPSED if is_warm and _is_settled(track, seen, settings) else Signal.CLEAR
    if track.frames + 1 < settings.baseline_frames:
        return Signal.CLEAR
    return Signal.TOUCH if _area(seen) >= settings.on_area else Signal.ELAPSED


def _settling_signal(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    level = _level(track, seen, settings)
    if level is Signal.CLEAR or not track.is_wanted:
        return level
    if _is_settled(track, seen, settings):
        return Signal.STILL
    is_late = _seconds(seen.timestamp_ns, track.wanted_ns) >= settings.settle_timeout_s
    return Signal.LATE if is_late else level


def _is_settled(track: Track, seen: Observation, settings: ContactSettings) -> bool:
    still_s = _seconds(seen.timestamp_ns, track.still_ns)
    return still_s >= settings.settle_s and track.still_frames >= settings.settle_frames


def _moved(
    track: Track, signal: Signal, seen: Observation, settings: ContactSettings
) -> tuple[Track, tuple[Event, ...]]:
    """Take the table's move; a change of state restarts the state's clock and may tell something."""
    state = TABLE[track.state, signal]
    if state is track.state:
        first_ns = track.since_ns if track.frames else seen.timestamp_ns
        return replace(track, frames=track.frames + 1, since_ns=first_ns), ()
    events = _told(track, signal, state, seen)
    return _entered(
        replace(track, state=state, since_ns=seen.timestamp_ns, frames=1), track, seen, settings
    ), events


def _entered(track: Track, before: Track, seen: Observation, settings: ContactSettings) -> Track:
    """What a new state begins with."""
    match before.state, track.state:
        case State.APPROACH, State.SETTLING:
            return replace(
                track,
                began_ns=seen.timestamp_ns,
                peak=_area(seen),
                is_counted=True,
                is_wanted=track.is_wanted or not settings.is_external,
                wanted_ns=seen.timestamp_ns,
            )
        case State.BASELINE, State.CONTACT:
            return replace(track, began_ns=seen.timestamp_ns, peak=_area(seen), is_counted=False)
        case _, State.RECOVERY:
            return replace(track, residue=_area(seen), is_wanted=False, is_counted=True)
        case State.APPROACH, State.NO_CONTACT:
            return replace(track, is_wanted=False)
    return track


def _told(track: Track, signal: Signal, state: State, seen: Observation) -> tuple[Event, ...]:
    now, sequence, began = seen.timestamp_ns, seen.sequence, track.began_ns
    match track.state, state:
        case State.BASELINE, State.NO_CONTACT:
            return (ReferenceReady(now),)
        case State.BASELINE, State.CONTACT:
            return (StartedTouched(now, _area(seen)),)
        case State.APPROACH, State.NO_CONTACT if track.is_wanted:
            return (TriggerWithoutContact(state),)
        case State.APPROACH, State.SETTLING:
            return (PressBegan(now, sequence),)
        case State.SETTLING, State.CONTACT if signal is Signal.STILL:
            return (PressSettled(now, _candidate(track, seen), began, seen.touch or Touch(0.0)),)
        case State.SETTLING, State.CONTACT:
            return (PressNotSettled(now, sequence, began, NotSettledReason.TIMED_OUT),)
        case State.EARLY_RELEASE, State.RECOVERY:
            reason = NotSettledReason.RELEASED if track.is_wanted else NotSettledReason.NOT_TRIGGERED
            return PressNotSettled(now, sequence, began, reason), PressEnded(now, sequence, began)
        case State.RELEASE, State.RECOVERY:
            return (PressEnded(now, sequence, began),) if track.is_counted else (ReferenceReady(now),)
    return ()


def _candidate(track: Track, seen: Observation) -> int:
    return seen.sequence if track.candidate is None else track.candidate
