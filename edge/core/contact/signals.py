"""The memory of contact detection between frames, and which signal of the table one frame gives."""

from dataclasses import dataclass, field
from typing import Final, Literal

from edge.core.contact.settings import ContactSettings
from edge.core.contact.settled_frame import CLEARLY_INVERSE, Observation, Window
from edge.core.contact.table import Signal, State

__all__ = [
    "ADDS_STRUCTURE",
    "IDLE",
    "LEARNING",
    "PRESSED",
    "RESIDUE_SHARE",
    "UNJUDGED",
    "WATCHED",
    "Phase",
    "Track",
    "is_touch",
    "level_of",
    "phase_of",
    "seconds",
    "signal_of",
]

LEARNING = frozenset({State.WARM_UP, State.BASELINE})
IDLE = frozenset({State.NO_CONTACT, State.RECOVERY})
UNJUDGED = frozenset({State.SETTLING, State.EARLY_RELEASE})
PRESSED = UNJUDGED | {State.CONTACT, State.RELEASE}
WATCHED = UNJUDGED | {State.APPROACH, State.DOUBT}


@dataclass(frozen=True)
class Track:
    """The memory of contact detection between frames.

    since_ns, frames: when the present state began, and over how many frames. still_ns, still_frames: the same for the
    view at rest while learning. peak, relief_peak, strength_peak: the largest area, relief and strength of this press.
    residue, relief_residue, strength_residue: the rest of the last press.
    """

    state: State = State.WARM_UP
    last_ns: int | None = None
    since_ns: int = 0
    frames: int = 0
    still_ns: int = 0
    still_frames: int = 0
    window: Window = field(default_factory=Window)
    """The frames of this press that may be chosen."""
    began_ns: int = 0
    is_wanted: bool = False
    wanted_ns: int = 0
    """The time since which a verdict is wanted."""
    grown_ns: int = 0
    """When the imprint last grew."""
    peak: float = 0.0
    relief_peak: float = 0.0
    strength_peak: float = 0.0
    decided_area: float = 0.0
    """Its largest area until its frame was chosen, or it was given up; the next is its largest strength until then."""
    decided_strength: float = 0.0
    touched_ns: int = 0
    """When something last touched that is no press."""
    sunk_ns: int | None = None
    """The time since which the strength is that of a residue; None while the press is held."""
    residue: float = 0.0
    relief_residue: float = 0.0
    strength_residue: float = 0.0
    is_counted: bool = True
    """False for a part that was there at the start."""
    is_confirmed: bool = False
    """Another picture of the free gel, or a press, has shown that the reference is one."""
    is_cycled: bool = False
    """A press has come and gone."""
    imprint: float = 0.0
    """Whether the view of this press has more structure than the reference, or less, at rest (`Relief.gain`)."""
    earlier_imprints: float = 0.0
    """The sum over the presses since the reference was learnt."""
    is_interrupted: bool = False
    blind_until_ns: int = 0

    @property
    def has_contact(self) -> bool:
        """True from `PressBegan` to `PressEnded`, and for a part that was there at the start."""
        return self.state in PRESSED


Phase = Literal["unseen", "free", "touching", "pressed", "resting", "decided", "over it"]
"""What a view shows of the present contact. unseen: nothing that can be trusted; touching: not yet, or hardly any more,
a press; resting: a press without a verdict that is at rest; decided: one whose frame is chosen, or that has none;
over it: so much more than what was decided that it may be another part."""


def phase_of(track: Track, seen: Observation | None, settings: ContactSettings) -> Phase:
    """Return what the last view shows. A press that shows nothing in two views, or no area in one, is over a moment
    before its end; a light contact that flickers is not."""
    if track.is_interrupted or (track.last_ns or 0) < track.blind_until_ns or not track.is_counted:
        return "unseen"
    match track.state:
        case State.NO_CONTACT | State.RECOVERY:
            # Of a corrected reference the next view is the first that shows anything.
            is_first = track.state is State.RECOVERY and track.frames == 1
            if seen is None or seen.is_black or is_first:
                return "free"
            has_just_touched = seconds(seen.timestamp_ns, track.touched_ns) < settings.idle_interval_s
            is_faint = has_just_touched and level_of(track, seen, settings) is not Signal.CLEAR
            return "touching" if is_faint or is_touch(track, seen, settings) else "free"
        case State.APPROACH:
            return "touching"
        case State.EARLY_RELEASE:
            return "free" if _is_over(track, seen, settings) else "touching"
        case State.SETTLING:
            return "resting" if track.window.is_at_rest(settings) else "pressed"
        case State.CONTACT:
            return "over it" if _is_pressed_over(track, seen, settings) else "decided"
        case State.RELEASE:
            return "free" if _is_over(track, seen, settings) else "decided"
    return "unseen"


def _is_over(track: Track, seen: Observation | None, settings: ContactSettings) -> bool:
    """Tell whether a press that is being lifted touches no more."""
    is_gone = seen is not None and seen.area == 0 and track.peak >= _WIDE_TIMES * settings.on_area
    return track.frames > 1 or is_gone


def _is_pressed_over(track: Track, seen: Observation | None, settings: ContactSettings) -> bool:
    """Tell whether a part seems to press over what touched lightly and was taken for a press, as a hair or a mark."""
    if seen is None or seen.strength < _NEW_PRESS_TIMES * track.decided_strength:
        return False
    return seen.area >= max(settings.on_area, _WIDER_TIMES * track.decided_area)


# A log ratio of structure (`Relief.gain`): a part that presses adds some, a reference learnt from a pressed gel has
# more than the free gel. Public frames without markers lie beyond 1.4 either way.
ADDS_STRUCTURE: Final = 0.35
# Relief that a press left behind varies by this much.
_RESIDUE_TIMES: Final = 1.2
# An imprint that stays below this share of its largest strength for this time is no longer held: a chip, grease, or
# gel that recovers, of which 5 to 25 % stay for half a second. A fingertip that rolls on a real gel falls below it for
# a shorter time.
RESIDUE_SHARE: Final = 0.4
_RESIDUE_S: Final = 0.2
# Foam springs back and still lies on the gel after its release, with less than this share of its largest strength.
_RECOIL_SHARE: Final = 0.1
# The area of a press that was this many times as large as a touch's does not vanish by noise.
_WIDE_TIMES: Final = 2
# Over a residue, an imprint of this many times its strength is a new press.
_NEW_PRESS_TIMES: Final = 2.0
# A press whose area grows by this much after it rested was hardly one.
_WIDER_TIMES: Final = 4.0
# A light press is over when its relief has fallen to this share: it has no area to decide by.
_LIGHT_RELEASE_SHARE: Final = 0.25


def seconds(later_ns: int, earlier_ns: int) -> float:
    return (later_ns - earlier_ns) / 1e9


def level_of(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    """Clear, faint or touch: hysteresis above the residue of the last press, by area, relief and strength."""
    if _is_clear(track, seen, settings):
        return Signal.CLEAR
    is_press = is_touch(track, seen, settings) and not _is_recoil(track, seen, settings)
    return Signal.TOUCH if is_press else Signal.FAINT


def is_touch(track: Track, seen: Observation, settings: ContactSettings) -> bool:
    """Tell whether something touches beyond the residue of the last press."""
    return (
        seen.area >= settings.on_area + track.residue
        or seen.relief >= settings.on_area + _RESIDUE_TIMES * track.relief_residue
        or _stands_out(track, seen, settings)
    )


def _is_recoil(track: Track, seen: Observation, settings: ContactSettings) -> bool:
    """Tell whether so little shows just after a press that it is the rest of it, not another one."""
    has_just_ended = track.state is State.RECOVERY and track.peak >= settings.on_area
    return has_just_ended and seen.depth < _RECOIL_SHARE * track.strength_peak


def _stands_out(track: Track, seen: Observation, settings: ContactSettings) -> bool:
    """Tell whether something presses over a residue, which may be as wide as the press."""
    return seen.area >= settings.on_area and seen.strength >= _NEW_PRESS_TIMES * track.strength_residue > 0


def _is_clear(track: Track, seen: Observation, settings: ContactSettings) -> bool:
    """Once a press has shown an area, its area alone says when it is over: its imprint stays in relief for seconds."""
    off, relief_off = (
        settings.off_area + track.residue,
        settings.off_area + _RESIDUE_TIMES * track.relief_residue,
    )
    if not track.has_contact:
        is_small = seen.area <= off and seen.relief <= relief_off
        return is_small and not _stands_out(track, seen, settings)
    if track.peak >= settings.on_area:
        is_residue = track.sunk_ns is not None and seconds(seen.timestamp_ns, track.sunk_ns) >= _RESIDUE_S
        is_small = seen.area <= off and not _stands_out(track, seen, settings)
        return is_residue or is_small or seen.area <= settings.release_share * track.peak
    return seen.area <= off and seen.relief <= max(relief_off, _LIGHT_RELEASE_SHARE * track.relief_peak)


def signal_of(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    match track.state:
        case State.WARM_UP | State.BASELINE:
            return _learning_signal(track, seen, settings)
        case State.SETTLING:
            return _settling_signal(track, seen, settings)
        case State.DOUBT:
            return _doubting_signal(track, seen, settings)
    level = level_of(track, seen, settings)
    if track.state is State.CONTACT and level is not Signal.CLEAR and _is_doubtful(track, seen, settings):
        return Signal.INVERSE
    if not _has_held(track, level, seen, settings):
        return level
    is_inverse = track.state is State.APPROACH and _is_inverse(track, seen)
    return Signal.INVERSE if is_inverse else Signal.ELAPSED


def _has_held(track: Track, level: Signal, seen: Observation, settings: ContactSettings) -> bool:
    """Tell whether the state's own condition has held for its time."""
    condition = {
        State.APPROACH: (Signal.TOUCH, settings.onset_s, settings.min_frames),
        State.EARLY_RELEASE: (Signal.CLEAR, settings.release_s, settings.min_frames),
        State.RELEASE: (Signal.CLEAR, settings.release_s, settings.min_frames),
        State.RECOVERY: (level if level is not Signal.TOUCH else None, settings.recovery_s, 1),
    }.get(track.state)
    if condition is None or level is not condition[0]:
        return False
    return seconds(seen.timestamp_ns, track.since_ns) >= condition[1] and track.frames + 1 >= condition[2]


def _learning_signal(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    if track.still_ns == seen.timestamp_ns:
        return Signal.MOVING
    if track.state is State.WARM_UP:
        is_warm = seconds(seen.timestamp_ns, track.since_ns) >= settings.warm_up_s
        is_still = seconds(seen.timestamp_ns, track.still_ns) >= settings.settle_s
        return Signal.ELAPSED if is_warm and is_still else Signal.CLEAR
    if track.frames + 1 < settings.baseline_frames:
        return Signal.CLEAR
    return Signal.TOUCH if seen.area >= settings.on_area else Signal.ELAPSED


def _settling_signal(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    level = level_of(track, seen, settings)
    if level is Signal.CLEAR:
        return level
    if track.window.is_at_rest(settings):
        if _is_inverse(track, seen):
            return Signal.INVERSE
        return Signal.STILL if track.is_wanted else level
    waited_ns = max(track.wanted_ns, track.grown_ns)
    is_late = track.is_wanted and seconds(seen.timestamp_ns, waited_ns) >= settings.settle_timeout_s
    return Signal.LATE if is_late else level


def _doubting_signal(track: Track, seen: Observation, settings: ContactSettings) -> Signal:
    """The free gel is the view at rest that adds no structure to the doubted reference."""
    level = level_of(track, seen, settings)
    if level is Signal.CLEAR:
        return level
    is_free = seen.imprint < ADDS_STRUCTURE and track.window.is_at_rest(settings)
    return Signal.FREE if is_free else level


def _is_inverse(track: Track, seen: Observation) -> bool:
    """Tell whether the view lost what the reference shows, as when a part is lifted that was taken for the free gel.

    What one press does not decide, several do: their log ratios add up.
    """
    return not track.is_confirmed and track.earlier_imprints + seen.imprint <= CLEARLY_INVERSE


def _is_doubtful(track: Track, seen: Observation, settings: ContactSettings) -> bool:
    """Doubt also a press that has its verdict, and a first one that never ends and adds no structure."""
    is_stuck = not track.is_cycled and seconds(seen.timestamp_ns, track.began_ns) >= settings.stuck_s
    adds_none = not track.is_confirmed and seen.imprint < ADDS_STRUCTURE
    return _is_inverse(track, seen) or (is_stuck and adds_none)
