"""The contact tracker: views in, events out. It keeps the pictures that the pure rules of `contact` need."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from edge.core.contact import rules as contact
from edge.core.contact.mask import Touch, changed_share, is_black, touched, touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.contact.rules import ContactSettings, Event, Observation, ReferenceRefreshed, State, Track

__all__ = ["ContactTracker"]


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
        self.total, self.frames = None, 0

    def view(self) -> View:
        if self.total is None:
            raise ValueError("a mean of no views was asked for")
        return (self.total / self.frames).astype(np.float32)


@final
class ContactTracker:
    """Follows one sensor's views. Feed every frame, or those that `is_due` asks for, in order.

    stored: the last reference of the same gel, if there is one; then a part that already presses at the start is
    noticed (`StartedTouched`) instead of being learnt as the free gel. Without it only a part that moves while the
    reference is learnt is noticed, so start with the gel free. After a change of gel call `relearn`.

    A caller that scores later keeps the camera frame whose sequence is `candidate` and the newest one; no other can be
    named by `PressSettled`.
    """

    def __init__(self, settings: ContactSettings | None = None, stored: Reference | None = None) -> None:
        self.settings = settings or ContactSettings()
        self._track = Track()
        self._reference = stored
        self._baseline, self._free = _Mean(), _Mean()
        self._rest: View | None = None
        self._last: View | None = None
        self._mask: NDArray[np.bool_] | None = None
        self._touch: Touch | None = None

    @property
    def state(self) -> State:
        return self._track.state

    @property
    def has_contact(self) -> bool:
        """True from `PressBegan` to `PressEnded`, and for a part that was there at the start."""
        return self._track.has_contact

    @property
    def reference(self) -> Reference | None:
        """The free gel as last learnt, or the stored one until then."""
        return self._reference

    @property
    def mask(self) -> NDArray[np.bool_] | None:
        """The touched area in the last view: bool (h, w); None before there is a reference."""
        return self._mask

    @property
    def touch(self) -> Touch | None:
        """Area and centroid of `mask`."""
        return self._touch

    @property
    def candidate(self) -> int | None:
        """The sequence of the frame that would be scored now."""
        return self._track.candidate

    def is_due(self, timestamp_ns: int) -> bool:
        """False for a frame that need not be decoded: nothing presses and the last look was a moment ago."""
        idle = self.state in (State.NO_CONTACT, State.RECOVERY)
        last_ns = self._track.last_ns
        return not idle or last_ns is None or timestamp_ns - last_ns >= self.settings.idle_interval_s * 1e9

    def feed(self, view: View, timestamp_ns: int, sequence: int) -> list[Event]:
        """One view: float32 (h, w, 3), 0 to 255. Errors: ValueError for another shape or a time that does not rise."""
        if view.dtype != np.float32 or view.ndim != 3 or view.shape[2] != 3:
            raise ValueError(f"a view is float32 (h, w, 3), found {view.dtype} {view.shape}")
        level = self._compared(view)
        seen = Observation(
            timestamp_ns=timestamp_ns,
            sequence=sequence,
            touch=self._touch,
            change=1.0 if self._rest is None else changed_share(level, self._rest),
            motion=1.0 if self._last is None else changed_share(level, self._last),
            is_black=is_black(view),
        )
        before = self.state
        self._track, events = contact.step(self._track, seen, self.settings)
        self._last = level
        if self._track.still_ns == timestamp_ns:
            self._rest = level
        return [*events, *self._learn(before, view, timestamp_ns)]

    def gap(self) -> list[Event]:
        """The stream was interrupted: device lost, stalled or re-opened. The reference and a press are kept."""
        self._track, events = contact.gap(self._track)
        self._baseline.clear()
        self._free.clear()
        return list(events)

    def trigger(self) -> list[Event]:
        """A verdict is asked for now."""
        self._track, events = contact.trigger(self._track)
        return list(events)

    def relearn(self) -> list[Event]:
        """Forget the reference and learn a new one, as after a change of gel."""
        self._track, events = contact.relearn(self._track)
        self._reference, self._mask, self._touch = None, None, None
        self._baseline.clear()
        self._free.clear()
        return list(events)

    def _compared(self, view: View) -> View:
        """The view at the reference's level, with mask and touch set; the view itself while there is no reference."""
        if self._reference is None:
            return view
        if self._reference.view.shape != view.shape:
            raise ValueError(
                f"the reference is {self._reference.view.shape}, this view {view.shape}; use views of one size"
            )
        difference = self._reference.difference(view)
        self._mask = touched_mask(difference)
        self._touch = touched(self._mask)
        return difference + self._reference.view

    def _learn(self, before: State, view: View, timestamp_ns: int) -> list[Event]:
        match before, self.state:
            case _, State.WARM_UP | State.CONTACT:
                self._baseline.clear()
            case _, State.BASELINE:
                self._baseline.add(view, timestamp_ns)
            case State.BASELINE, State.NO_CONTACT:
                self._baseline.add(view, timestamp_ns)
                self._reference = Reference(self._baseline.view(), self._baseline.frames, timestamp_ns)
                self._baseline.clear()
        return self._refreshed(view, timestamp_ns)

    def _refreshed(self, view: View, timestamp_ns: int) -> list[Event]:
        """Follow the free gel, and only it: no press, no residue, and the recovery time over."""
        is_free = self.state is State.NO_CONTACT and self._touch is not None and not is_black(view)
        if (
            self._reference is None
            or not is_free
            or (self._touch and self._touch.area > self.settings.off_area)
        ):
            self._free.clear()
            return []
        self._free.add(view, timestamp_ns)
        if timestamp_ns - self._free.since_ns < self.settings.refresh_s * 1e9:
            return []
        old = self._reference
        self._reference = old.refreshed(self._free.view(), self.settings.refresh_weight, timestamp_ns)
        self._free.clear()
        return [ReferenceRefreshed(timestamp_ns, float(np.abs(self._reference.view - old.view).mean()))]
