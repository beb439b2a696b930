"""Which frame of which press: camera frames in, contact events out, and the frame that each settled press gives.

The gateway, `fit` and `record` all find their presses here, so that the same frames are learnt and scored. It leaves
out broken and repeated frames, and detects interruptions by the frames' own times. It decodes only the frames that
contact detection needs, and keeps the few frames that may still be chosen.
"""

from collections import deque
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.events import Event, PressSettled
from edge.core.contact.mask import Touch
from edge.core.contact.reference import Reference, View
from edge.core.contact.relief import Relief
from edge.core.contact.settings import ContactSettings
from edge.core.contact.settled_frame import Observation
from edge.core.contact.sight import Sight
from edge.core.contact.signals import IDLE, Phase
from edge.core.contact.table import State
from edge.core.contact.tracker import ContactTracker
from edge.core.errors import FrameCorrupt
from edge.core.imaging.decode import decode_view
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import Freshness
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["Look", "PressDetector"]

# Frames further apart than this are an interruption: five frames at the 18.75 fps that the sensor delivers.
GAP_S: Final = 0.27

# A held press whose compressed picture differs from the free gel's by less than this share, or by less than this many
# times what the free gel's own sizes vary by, is looked at in every frame. So is one whose size has come this part of
# the way back: the picture of a lifted part has the size of the free gel's.
_TELLING_SHARE: Final = 0.01
_TELLING_TIMES: Final = 4
_BACK_SHARE: Final = 0.25
_FREE_SIZES: Final = 8

# A frame of the free gel whose compressed size is beyond those of so long is looked at: a contact that begins gives one
# record after the other. Chance gives 2 of 1 + 0.5 s of frames, and with that 1.2 to 1.3 times the looks, at any rate.
_RECORD_S: Final = 0.5


@final
class IdleSizes:
    """Says by compressed sizes which frames of the free gel may show something new."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, int]] = deque()

    def is_record(self, size: int, timestamp_ns: int) -> bool:
        """Take the size of a frame, and tell whether it is larger or smaller than each of the last `_RECORD_S`."""
        recent = self._recent
        while recent and timestamp_ns - recent[0][0] > _RECORD_S * 1e9:
            recent.popleft()
        sizes = [earlier for _, earlier in recent]
        recent.append((timestamp_ns, size))
        return bool(sizes) and not min(sizes) <= size <= max(sizes)


@final
class HeldPress:
    """Says which frames need not be decoded while a press that has its verdict is held: those whose compressed size is
    still that of the press, as far as the size tells it from the free gel's."""

    def __init__(self) -> None:
        self._free: deque[int] = deque(maxlen=_FREE_SIZES)
        self._held: int | None = None
        self._room = 0.0

    def look(self, state: State, size: int, *, is_settled: bool) -> None:
        """Take a frame that was decoded, with the state after it. is_settled: the press got its verdict with it."""
        if state in IDLE:
            self._free.append(size)
        if state is not State.CONTACT:
            self._held = None
        elif is_settled and self._free:
            low, high = min(self._free), max(self._free)
            apart = max(low - size, size - high, 0)
            is_telling = apart >= max(_TELLING_SHARE * low, _TELLING_TIMES * (high - low))
            self._held, self._room = (size, _BACK_SHARE * apart) if is_telling else (None, 0.0)

    def is_as_before(self, size: int) -> bool:
        """Tell whether the part is still pressed by the size of a frame; False where the size does not tell it."""
        return self._held is not None and abs(size - self._held) < self._room


@dataclass(frozen=True, eq=False)
class Look:
    """What one camera frame shows."""

    timestamp_ns: int
    """The time of the frame."""
    events: tuple[Event, ...]
    """What it completes, in order."""
    state: State
    """What the gel does after it."""
    sight: Sight
    """Whether the sensor shows its gel."""
    level: View | None
    """Its view at the level of the free gel, float32 (h, w, 3); None for a frame that was not decoded, or is blind."""
    interruption_s: float = 0.0
    """How long nothing was seen before it, where that was an interruption."""
    phase: Phase = "unseen"
    """What it shows of the contact."""
    seen: Observation | None = None
    """It in numbers; None as `level` is."""
    mask: NDArray[np.bool_] | None = None
    """Where it is touched, bool (h, w); None as `level` is, and before there is a reference, as the next one."""
    relief: Relief | None = None
    """The fine structure that it adds."""


@final
class PressDetector:
    """Finds the presses in one sensor's frames. Feed every frame, in order; it has no clock but the frames' times.

    corrupt: frames that could not be read, or are blind. first_fault: why, for the first of them. newest: the last that
    showed the gel. sight: whether the frames show it.
    """

    def __init__(
        self,
        profile: SensorProfile,
        settings: ContactSettings | None = None,
        stored: Reference | None = None,
        witness: Reference | None = None,
    ) -> None:
        self.tracker = ContactTracker(settings, stored, witness)
        self.sight = Sight()
        self.corrupt = 0
        self.first_fault: str | None = None
        self._profile = profile
        self._freshness = Freshness()
        self._last_ns: int | None = None
        self._came_ns: int | None = None
        self._shown_ns: int | None = None
        self.newest: CameraFrame | None = None
        self._kept: dict[int, CameraFrame] = {}
        self._held, self._sizes = HeldPress(), IdleSizes()
        self._interruption_s = 0.0

    def feed(self, frame: CameraFrame) -> Look:
        """Take one frame. One that cannot be read, or is blind, is counted in `corrupt` and changes nothing."""
        self._interruption_s = 0.0
        events, level = self._take(frame)
        self._came_ns = frame.timestamp_ns
        full_events = tuple(
            replace(event, frame=self._kept.get(event.sequence)) if isinstance(event, PressSettled) else event
            for event in events
        )
        state, interruption_s = self.tracker.state, self._interruption_s
        tracker = self.tracker
        shown = (None, None, None) if level is None else (tracker.seen, tracker.mask, tracker.relief)
        return Look(
            frame.timestamp_ns, full_events, state, self.sight, level, interruption_s, tracker.phase, *shown
        )

    @property
    def probable(self) -> tuple[CameraFrame, Touch] | None:
        """The frame that the press will most likely be judged by, and what it touches."""
        probable = self.tracker.probable
        frame = None if probable is None else self._kept.get(probable.sequence)
        return None if probable is None or frame is None else (frame, probable.contact)

    def _take(self, frame: CameraFrame) -> tuple[list[Event], View | None]:
        if frame.damage is not None:
            self._count_corrupt(f"frame {frame.sequence} is {frame.damage}", frame)
            return [], None
        if not self._is_new(frame):
            return [], None
        events = self._interrupted_before(frame)
        size = len(frame.payload)
        is_held = self._held.is_as_before(size)
        is_new = self._sizes.is_record(size, frame.timestamp_ns)
        if not self.tracker.is_due(frame.timestamp_ns, is_held=is_held, is_new=is_new):
            self._shown_ns = frame.timestamp_ns  # as far as it is known
            return events, None
        try:
            view = decode_view(frame, self._profile)
        except FrameCorrupt as error:
            self._count_corrupt(str(error), frame)
            return events, None
        if not self.sight.see(view, frame.timestamp_ns, self.tracker.light):
            self._count(f"frame {frame.sequence} does not show the gel")
            return events, None
        events += self._unseen_before(frame)
        self.newest = self._kept[frame.sequence] = frame
        events += self.tracker.feed(view, frame.timestamp_ns, frame.sequence)
        is_settled = any(isinstance(event, PressSettled) for event in events)
        self._held.look(self.tracker.state, size, is_settled=is_settled)
        return events, self.tracker.level

    def _is_new(self, frame: CameraFrame) -> bool:
        """False for the last frame delivered again, and for one whose time does not rise."""
        is_later = self._last_ns is None or frame.timestamp_ns > self._last_ns
        is_new = self._freshness.is_new(frame.payload)
        if not is_new:
            self.sight.miss("it repeats one frame", frame.timestamp_ns)
        return is_new and is_later

    def _interrupted_before(self, frame: CameraFrame) -> list[Event]:
        kept = self.tracker.candidates
        self._kept = {sequence: old for sequence, old in self._kept.items() if sequence in kept}
        last_ns, self._last_ns = self._last_ns, frame.timestamp_ns
        if last_ns is None or frame.timestamp_ns - last_ns <= GAP_S * 1e9:
            return []
        seen_ns = min(last_ns, self._shown_ns or last_ns)  # the frames between may have shown nothing
        self._interruption_s = (frame.timestamp_ns - seen_ns) / 1e9
        self._shown_ns = frame.timestamp_ns
        if (
            self._came_ns is None or frame.timestamp_ns - self._came_ns > GAP_S * 1e9
        ):  # broken frames are no pause
            self.sight.resume(frame.timestamp_ns)
        return self.tracker.gap()

    def _unseen_before(self, frame: CameraFrame) -> list[Event]:
        """Take frames that showed nothing for an interruption too: what pressed before them may be another part now."""
        shown_ns, self._shown_ns = self._shown_ns, frame.timestamp_ns
        if shown_ns is None or frame.timestamp_ns - shown_ns <= GAP_S * 1e9:
            return []
        self._interruption_s = (frame.timestamp_ns - shown_ns) / 1e9
        return self.tracker.gap()

    def _count_corrupt(self, fault: str, frame: CameraFrame) -> None:
        self._count(fault)
        self.sight.miss(fault, frame.timestamp_ns)

    def _count(self, fault: str) -> None:
        self.corrupt += 1
        self.first_fault = self.first_fault or fault
