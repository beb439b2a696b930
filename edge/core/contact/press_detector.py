"""Which frame of which press: camera frames in, contact events out, and the frame that each settled press gives.

The gateway, `fit` and `record` all find their presses here, so that the same frames are learnt and scored. It leaves
out broken and repeated frames, and detects interruptions by the frames' own times. It decodes only the frames that
contact detection needs, and keeps the few frames that may still be chosen.
"""

from dataclasses import dataclass, replace
from typing import Final, final

from edge.core.contact.events import Event, PressSettled
from edge.core.contact.mask import Touch
from edge.core.contact.reference import Reference, View
from edge.core.contact.settings import ContactSettings
from edge.core.contact.sight import Sight
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
        self.newest: CameraFrame | None = None
        self._kept: dict[int, CameraFrame] = {}

    def feed(self, frame: CameraFrame) -> Look:
        """Take one frame. One that cannot be read, or is blind, is counted in `corrupt` and changes nothing."""
        events, level = self._take(frame)
        found = tuple(
            replace(event, frame=self._kept.get(event.sequence)) if isinstance(event, PressSettled) else event
            for event in events
        )
        return Look(frame.timestamp_ns, found, self.tracker.state, self.sight, level)

    @property
    def probable(self) -> tuple[CameraFrame, Touch] | None:
        """The frame that the press will most likely be judged by, and what it touches."""
        probable = self.tracker.probable
        frame = None if probable is None else self._kept.get(probable.sequence)
        return None if probable is None or frame is None else (frame, probable.contact)

    def _take(self, frame: CameraFrame) -> tuple[list[Event], View | None]:
        if not self._is_sound(frame) or not self._is_new(frame):
            return [], None
        events = self._interrupted_before(frame)
        if not self.tracker.is_due(frame.timestamp_ns):
            return events, None
        try:
            view = decode_view(frame, self._profile)
        except FrameCorrupt as error:
            self._count_corrupt(str(error), frame)
            return events, None
        if not self.sight.see(view, frame.timestamp_ns):
            self._count(f"frame {frame.sequence} does not show the gel")
            return events, None
        self.newest = self._kept[frame.sequence] = frame
        return [*events, *self.tracker.feed(view, frame.timestamp_ns, frame.sequence)], self.tracker.level

    def _is_sound(self, frame: CameraFrame) -> bool:
        if frame.damage is not None:
            self._count_corrupt(f"frame {frame.sequence} is {frame.damage}", frame)
        return frame.damage is None

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
        self.sight.resume(frame.timestamp_ns)
        return self.tracker.gap()

    def _count_corrupt(self, fault: str, frame: CameraFrame) -> None:
        self._count(fault)
        self.sight.miss(fault, frame.timestamp_ns)

    def _count(self, fault: str) -> None:
        self.corrupt += 1
        self.first_fault = self.first_fault or fault
