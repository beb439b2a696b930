"""What contact detection finds in a recording: how many presses, how many rested, and what is wrong with its frames."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from edge.core.contact.events import PressNotSettled, PressSettled, ReferenceCorrected
from edge.core.contact.mask import Touch
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.settings import ContactSettings
from edge.core.contact.wear import foreign_free_gel
from edge.core.imaging.sensor_profile import SensorProfile
from edge.recording.format import Recording

__all__ = ["FoundPresses", "presses_in"]


@dataclass(frozen=True)
class FoundPresses:
    """settled, not_settled: presses. unread: frames that were refused; first_fault: why. doubts: what a person should
    know before the recording is used."""

    settled: int
    not_settled: int
    unread: int
    first_fault: str | None
    doubts: tuple[str, ...]

    def __str__(self) -> str:
        said = f"{self.settled + self.not_settled} presses, {self.settled} of them at rest"
        return (
            said
            if not self.unread
            else f"{said}; {self.unread} frames refused, the first: {self.first_fault}"
        )


def presses_in(
    recording: Recording, profile: SensorProfile, settings: ContactSettings | None = None
) -> FoundPresses:
    """Look through a recording as the gateway would."""
    detector = PressDetector(profile, settings)
    touches: list[Touch] = []
    reliefs: list[float] = []
    counts: Counter[type] = Counter()
    for recorded in recording:
        for event in detector.feed(recorded.frame).events:
            counts[type(event)] += 1
            if isinstance(event, PressSettled) and event.findings is not None:
                touches.append(event.touch)
                reliefs.append(event.findings.relief.area)
    doubts = _doubts(touches, reliefs, began_pressed=counts[ReferenceCorrected] > 0)
    return FoundPresses(
        counts[PressSettled], counts[PressNotSettled], detector.corrupt, detector.first_fault, doubts
    )


def _doubts(touches: Sequence[Touch], reliefs: Sequence[float], *, began_pressed: bool) -> tuple[str, ...]:
    light = foreign_free_gel(touches, reliefs)
    began = (
        "it begins with a part on the gel; begin with the gel free for two seconds" if began_pressed else None
    )
    return tuple(doubt for doubt in (light, began) if doubt)
