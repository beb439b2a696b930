"""What contact detection finds in a recording: its presses, how many rested, and what is wrong with its frames."""

from collections import Counter

from edge.core.contact.events import PressNotSettled, PressSettled, ReferenceCorrected
from edge.core.contact.mask import Touch
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.wear import foreign_free_gel
from edge.core.errors import RecordingError
from edge.core.imaging.known_profiles import PROFILES
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.printable import write_count
from edge.recording.format import Recording

__all__ = ["find_profile", "find_settled", "presses_in"]


def find_profile(recording: Recording, name: str | None = None) -> SensorProfile | None:
    """Return the profile of this name, else the one of the recording's name, else one for frames of its size."""
    header = recording.header
    known = PROFILES.get(name or "") or PROFILES.get(header.profile or "")
    return known or next((profile for profile in PROFILES.values() if profile.native == header.mode), None)


def find_settled(recording: Recording, number: int) -> PressSettled:
    """Find a press that rested, as the gateway would, by its number from 1 on. Errors: RecordingError."""
    profile = find_profile(recording)
    if profile is None:
        raise RecordingError(f"no sensor profile has frames of the size of recording {recording.folder}")
    detector, count = PressDetector(profile), 0
    for recorded in recording:
        for event in detector.feed(recorded.frame).events:
            count += isinstance(event, PressSettled)
            if isinstance(event, PressSettled) and count == number:
                return event
    raise RecordingError(
        f"recording {recording.folder} has {write_count(count, 'press')} at rest, found --number {number}; count from 1"
    )


def presses_in(recording: Recording, profile: SensorProfile) -> tuple[str, list[str]]:
    """Look through a recording as the gateway would: what is found, and what a person should know before its use."""
    detector = PressDetector(profile)
    counts: Counter[type] = Counter()
    touches, reliefs = list[Touch](), list[float]()
    for recorded in recording:
        for event in detector.feed(recorded.frame).events:
            counts[type(event)] += 1
            if isinstance(event, PressSettled) and event.findings is not None:
                touches.append(event.touch)
                reliefs.append(event.findings.relief.area)
    presses = counts[PressSettled] + counts[PressNotSettled]
    summary = f"{write_count(presses, 'press')}, {counts[PressSettled]} of them at rest"
    if detector.corrupt:
        summary += f"; {write_count(detector.corrupt, 'frame')} refused, the first: {detector.first_fault}"
    doubt = foreign_free_gel(touches, reliefs)
    doubts = [] if doubt is None else [doubt]
    if counts[ReferenceCorrected]:
        doubts.append("it begins with a part on the gel; begin with the gel free for two seconds")
    return summary, doubts
