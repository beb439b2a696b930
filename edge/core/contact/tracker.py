"""The contact tracker: views in, events out. It keeps the pictures that the pure rules of `contact` need."""

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from edge.core.contact import rules as contact
from edge.core.contact.events import Event, Findings, PressSettled, ReferenceCorrected, ReferenceRefreshed
from edge.core.contact.mask import (
    Touch,
    imprint_strength,
    is_black,
    mask_beyond,
    measure_change,
    squared_distance,
    touched,
    touched_mask,
)
from edge.core.contact.reference import GAIN_RANGE, Reference, View
from edge.core.contact.relief import Relief, ReliefOfReference, with_relief
from edge.core.contact.settings import ContactSettings
from edge.core.contact.settled_frame import DEPTH_NOISE, Observation
from edge.core.contact.sight import Light, measure_light
from edge.core.contact.signals import ADDS_STRUCTURE, IDLE, LEARNING, PRESSED, WATCHED, Phase, Track, phase_of
from edge.core.contact.table import State

__all__ = ["ContactTracker"]

# A picture of another gel differs all over; one of this gel, at most where a part lies.
_LENT_AREA = 0.6
# The value for a view that agrees with another picture of the free gel: no press adds less structure.
_WITNESSED = -9.0


@dataclass
class _Mean:
    """A running mean of views, float64 inside."""

    total: NDArray[np.float64] | None = None
    frames: int = 0
    since_ns: int = 0

    def add(self, view: View, timestamp_ns: int) -> None:
        if self.total is None:
            self.total, self.frames, self.since_ns = np.zeros(view.shape), 0, timestamp_ns
        self.total += view
        self.frames += 1

    def clear(self) -> None:
        self.total = None

    def view(self) -> View:
        if self.total is None:
            raise ValueError("a mean of no views was requested")
        return (self.total / self.frames).astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Seen:
    """One view that may still matter: at the reference's level, and where it is touched."""

    level: View
    mask: NDArray[np.bool_] | None
    relief: Relief | None


@final
class ContactTracker:
    """Follows one sensor's views. Feed every frame, or those that `is_due` asks for, in order.

    stored: the last reference of the same gel, if there is one; then a part that already presses at the start is
    noticed (`StartedTouched`) instead of being learnt as the free gel. witness: another picture of a free gel, such as
    the one that the bundle was fitted with; it stands in for the stored one as far as it resembles this gel. Without
    both a reference that was learnt from a pressed gel is recognised at the lift. After a change of gel call `relearn`.

    A caller that scores later keeps the camera frames whose sequences are among `candidates`, and the newest one; no
    other can be named by `PressSettled`.
    """

    def __init__(
        self,
        settings: ContactSettings | None = None,
        stored: Reference | None = None,
        witness: Reference | None = None,
    ) -> None:
        self.settings = settings or ContactSettings()
        self._track = Track()
        self._witness = witness
        self._is_lent = stored is None and witness is not None
        self.reference: Reference | None = None
        """The free gel as last learnt, or the stored one until then."""
        self._light: Light | None = None
        self._structure: ReliefOfReference | None = None
        self._touched_then: float | None = None
        self._light_at_fit = None if witness is None else float(witness.view.mean())
        self._dimming = 1.0
        self._refer_to(stored or witness)
        self._baseline, self._free = _Mean(), _Mean()
        self._free_looks: tuple[View, ...] = ()
        self._newest_free: tuple[View, ...] = ()
        self._free_ns = 0
        self._grown_ns, self._depth = -math.inf, 0.0
        self._rest: View | None = None
        self.level: View | None = None
        """The last view, at the reference's level where there is one: float32 (h, w, 3)."""
        self._recent: dict[int, _Seen] = {}
        self.mask: NDArray[np.bool_] | None = None
        """The touched area in the last view, bool (h, w); None before there is a reference, as the next two."""
        self.touch: Touch | None = None
        """Area and centroid of `mask`."""
        self.relief: Relief | None = None
        """The fine structure that the last view adds."""
        self.seen: Observation | None = None
        """The last view in numbers."""

    @property
    def state(self) -> State:
        return self._track.state

    @property
    def has_contact(self) -> bool:
        """True from `PressBegan` to `PressEnded`, and for a part that was there at the start."""
        return self._track.has_contact

    @property
    def is_confirmed(self) -> bool:
        """True once the reference is known to be of the free gel: it agrees with an earlier one, or a press has added
        structure to it and gone."""
        return self._track.is_confirmed

    @property
    def light(self) -> Light | None:
        """Return that of the free gel, once it was learnt here and is known to be one."""
        return self._light if self.is_confirmed else None

    @property
    def phase(self) -> Phase:
        """What the last view shows, for a robot or a hand."""
        return phase_of(self._track, self.seen, self.settings)

    @property
    def candidates(self) -> frozenset[int]:
        """The sequences of the frames that may still be scored."""
        return self._track.window.candidates

    @property
    def probable(self) -> Observation | None:
        """The frame that is taken if the press goes on to rest, or to be lifted; None where none is foreseen."""
        track = self._track
        if not track.is_wanted or not track.window.frames:
            return None
        match track.state:
            case State.SETTLING:
                return track.window.foresee(track.wanted_ns, self.settings)
            case State.EARLY_RELEASE:
                return track.window.choose_peak(track.wanted_ns, track.strength_peak)
        return None

    @property
    def newest_free(self) -> View | None:
        """The newest view of the free gel as the sensor showed it, but for the last two: they may show an approach."""
        return self._newest_free[0] if self._newest_free else None

    def is_due(self, timestamp_ns: int, *, is_held: bool = False, is_new: bool = False) -> bool:
        """False for a frame that need not be decoded: nothing touched or grew for a moment and it hardly shows anything
        `is_new`, or a press that has its verdict `is_held` as before, and the last look was a moment ago."""
        interval_ns = self.settings.idle_interval_s * 1e9
        shown_ns = max(self._grown_ns, self._track.touched_ns)
        is_free = self.state in IDLE and not is_new and timestamp_ns - shown_ns >= interval_ns
        idle = is_free or (is_held and self.state is State.CONTACT)
        last_ns = self._track.last_ns
        return not idle or last_ns is None or timestamp_ns - last_ns >= interval_ns

    def feed(self, view: View, timestamp_ns: int, sequence: int) -> list[Event]:
        """Take a view: float32 (h, w, 3), 0 to 255. Errors: ValueError for a wrong shape or an earlier time."""
        if view.dtype != np.float32 or view.ndim != 3 or view.shape[2] != 3:
            raise ValueError(f"a view is float32 (h, w, 3), found {view.dtype} {view.shape}")
        self.seen, level = seen, _ = self._observe(view, timestamp_ns, sequence)
        before = self.state
        self._recent[sequence] = _Seen(level, self.mask, self.relief)
        self._track, stepped = contact.step(self._track, seen, self.settings)
        events = [
            replace(event, findings=self._findings(event)) if isinstance(event, PressSettled) else event
            for event in stepped
        ]
        if any(isinstance(event, ReferenceCorrected) for event in events):
            views = [self._recent[frame.sequence].level for frame in self._track.window.frames]
            corrected = Reference(np.mean(views, axis=0, dtype=np.float32))
            self._refer_to(corrected)
            self._light = measure_light(corrected.view)
        self.level = level
        # Looks that follow each other at once may all show an approach.
        is_apart = timestamp_ns - self._free_ns >= self.settings.idle_interval_s * 1e9
        is_free = self.state in IDLE and self.phase != "unseen" and not seen.is_black
        if is_free and is_apart:
            self._newest_free, self._free_ns = (*self._newest_free[-2:], view), timestamp_ns
        has_grown = seen.depth > self._depth + DEPTH_NOISE
        self._depth = seen.depth if has_grown else min(seen.depth, self._depth)
        self._grown_ns = timestamp_ns if has_grown else self._grown_ns
        if self._track.still_ns == timestamp_ns:
            self._rest = level
        kept = self.candidates
        self._recent = {number: recent for number, recent in self._recent.items() if number in kept}
        return [*events, *self._learn(before, view, timestamp_ns)]

    def gap(self) -> list[Event]:
        """The stream was interrupted: device lost, stalled or re-opened. The reference and a press are kept."""
        self._track, events = contact.gap(self._track)
        self._free.clear()
        return list(events)

    def trigger(self) -> list[Event]:
        """A verdict is requested now."""
        self._track, events = contact.trigger(self._track)
        return list(events)

    def relearn(self) -> list[Event]:
        """Forget the reference and learn a new one, as after a change of gel."""
        self._track, events = contact.relearn(self._track)
        self._refer_to(None)
        self._light = None
        self.mask, self.touch, self.relief = None, None, None
        self._free_looks = self._newest_free = ()
        self._is_lent = False
        self._witness = None
        return list(events)  # with the next view nothing rests, so no mean goes on

    def _observe(self, view: View, timestamp_ns: int, sequence: int) -> tuple[Observation, View]:
        """The view in numbers, and at the reference's level; the view itself while there is no reference."""
        if self.reference is None or self._structure is None:
            change, motion = self._change(view, timestamp_ns), self._motion(view)
            return Observation(timestamp_ns, sequence, None, change, motion, is_black(view)), view
        if self.reference.view.shape != view.shape:
            raise ValueError(
                f"the reference is {self.reference.view.shape}, this view {view.shape}; use views of one size"
            )
        difference = self.reference.difference(view)
        squared = squared_distance(difference)
        self.mask = mask_beyond(squared)
        self.touch = touched(self.mask)
        self.relief = self._structure.of(difference, self.settings.light_levels)
        imprint = self._imprint(view)
        # The difference to a lent picture is a part's where it adds structure, and not all over.
        is_pressed = self.touch.area < _LENT_AREA and imprint >= ADDS_STRUCTURE
        is_foreign = self._is_lent and self.state in LEARNING and not is_pressed
        level = difference + self.reference.view
        return Observation(
            timestamp_ns=timestamp_ns,
            sequence=sequence,
            touch=None if is_foreign else self.touch,
            change=self._change(level, timestamp_ns),
            motion=self._motion(level),
            is_black=is_black(view),
            relief=self.relief.area,
            strength=imprint_strength(squared * np.float32(self._dimming**2)),
            texture=self.relief.level,
            imprint=imprint,
            place=self._place(),
        ), level

    def _findings(self, settled: PressSettled) -> Findings | None:
        """Return None only without a reference, against which no press settles."""
        seen, reference = self._recent[settled.sequence], self.reference
        if seen.mask is None or seen.relief is None or reference is None:
            return None
        mask = with_relief(seen.mask, seen.relief, self.settings.on_area)
        return Findings(mask, seen.level, reference.view, seen.relief, self._noise_levels())

    def _noise_levels(self) -> float | None:
        """Measure the temporal noise of the free gel, without the look just before a contact: the part may be in it."""
        if len(self._free_looks) < 3:
            return None
        earlier, later, _ = self._free_looks
        return float(np.std(later - earlier, dtype=np.float64) / np.sqrt(2))

    def _place(self) -> Touch | None:
        """The place of a contact that is too light to have an area; computed only during a press."""
        if self.state not in WATCHED or self.mask is None or self.relief is None:
            return None
        seen = with_relief(self.mask, self.relief, self.settings.on_area)
        return None if seen is self.mask else touched(seen)

    def _change(self, level: View, timestamp_ns: int) -> float:
        """Against the view at rest while learning, and `settle_s` ago during a press; 1 where that is not known."""
        if self.state in LEARNING:
            return 1.0 if self._rest is None else measure_change(level, self._rest)
        anchor = self._track.window.anchor(timestamp_ns, self.settings)
        return 1.0 if anchor is None else measure_change(level, self._recent[anchor.sequence].level)

    def _motion(self, level: View) -> float:
        """Against the view before; computed only during a press."""
        if self.state not in WATCHED or self.level is None:
            return 1.0
        return measure_change(level, self.level)

    def _imprint(self, view: View) -> float:
        """Measure whether the view shows more or less structure than the reference; 0 where nothing is in doubt."""
        is_asked = self.state is State.BASELINE or self.state in PRESSED or self.state in WATCHED
        if self._track.is_confirmed or not is_asked or self.relief is None or self.mask is None:
            return 0.0
        if self._agrees_with_witness(view):
            return _WITNESSED
        return self.relief.gain(self.mask)

    def _agrees_with_witness(self, view: View) -> bool:
        """Tell whether a view looks touched because the reference is: the view is the free gel of the bundle, and the
        reference is not. A press that begins has no area yet, and leaves the reference the free gel."""
        witness, reference = self._witness, self.reference
        if witness is None or reference is None or self._is_lent or self.state in LEARNING:
            return False
        if witness.view.shape != view.shape:
            return False
        if self._touched_then is None:
            self._touched_then = _find_area(witness, reference.view)
        if self._touched_then < self.settings.on_area:
            return False
        return _find_area(witness, view) < self.settings.off_area

    def _refer_to(self, reference: Reference | None) -> None:
        self.reference, self._touched_then = reference, None
        self._structure = None if reference is None else ReliefOfReference(reference.view)
        if reference is not None and self._light_at_fit is not None:
            # A dark gel shows all of an imprint darker; by its strength a press is compared with those at fit.
            self._dimming = float(np.clip(self._light_at_fit / max(reference.view.mean(), 1.0), *GAIN_RANGE))

    def _learn(self, before: State, view: View, timestamp_ns: int) -> list[Event]:
        match before, self.state:
            case _, State.WARM_UP | State.CONTACT:
                self._baseline.clear()
            case _, State.BASELINE:
                self._baseline.add(view, timestamp_ns)
            case State.BASELINE, State.NO_CONTACT:
                self._baseline.add(view, timestamp_ns)
                self._refer_to(Reference(self._baseline.view()))
                self._light = measure_light(self._baseline.view())
                self._is_lent = False
                self._baseline.clear()
        return self._refresh(view, timestamp_ns)

    def _refresh(self, view: View, timestamp_ns: int) -> list[Event]:
        """Follow the free gel, and only it: no press, no residue, and the recovery time over."""
        old, touch, relief = self.reference, self.touch, self.relief
        if (
            self.state is not State.NO_CONTACT
            or old is None
            or touch is None
            or relief is None
            or is_black(view)
            or touch.area > self.settings.off_area
            or relief.area >= self.settings.on_area
        ):
            self._free.clear()
            return []
        self._free.add(view, timestamp_ns)
        if self._free_ns == timestamp_ns:
            self._free_looks = (*self._free_looks[-2:], view)
        if timestamp_ns - self._free.since_ns < self.settings.refresh_s * 1e9:
            return []
        new = old.refresh(self._free.view(), self.settings.refresh_weight)
        self._refer_to(new)
        self._light = measure_light(new.view)
        self._free.clear()
        return [ReferenceRefreshed(timestamp_ns, float(np.abs(new.view - old.view).mean()))]


def _find_area(free: Reference, view: View) -> float:
    """Find the share of a view that is touched, by this picture of the free gel."""
    return touched(touched_mask(free.difference(view))).area
