"""The presses in a stream of camera frames, found exactly as the gateway finds them, and the free gel before each."""

from collections.abc import Iterator
from dataclasses import dataclass

from edge.core.arrays import Mask
from edge.core.contact.events import PressBegan, PressSettled, ReferenceReady
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.settings import ContactSettings
from edge.core.contact.table import State
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.sensor_profile import SensorProfile

__all__ = ["FoundPress", "PressFinder"]


@dataclass(frozen=True, eq=False)
class FoundPress:
    """The settled frame of a press."""

    frame: CameraFrame
    mask: Mask | None
    """Where it touches, bool (120, 160); None where the free gel is not known."""


class PressFinder:
    """Feed it every frame of one sensor, in order. settled: presses found so far."""

    def __init__(self, profile: SensorProfile, settings: ContactSettings | None = None) -> None:
        self.detector = PressDetector(profile, settings)
        self.settled = 0
        self._last_free: CameraFrame | None = None

    def feed(self, frame: CameraFrame) -> Iterator[FoundPress | CameraFrame]:
        """Yield a press that this frame completes, and the last frame of the free gel before one."""
        for event in self.detector.feed(frame).events:
            if isinstance(event, PressSettled) and event.frame is not None:
                self.settled += 1
                seen = event.findings
                yield FoundPress(event.frame, seen.mask if seen else None)
            elif isinstance(event, PressBegan | ReferenceReady) and self._last_free is not None:
                yield self._last_free
        if self.detector.tracker.state in (State.BASELINE, State.NO_CONTACT):
            self._last_free = self.detector.newest
