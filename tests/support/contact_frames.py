"""Frames for the contact rules, as numbers: one press or several, at any rate."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from edge.core.contact.events import Event, PressNotSettled
from edge.core.contact.mask import Touch
from edge.core.contact.reference import View
from edge.core.contact.rules import step
from edge.core.contact.settings import ContactSettings
from edge.core.contact.settled_frame import Observation
from edge.core.contact.signals import Track
from edge.core.contact.table import State

RULES = ContactSettings()
FREE, FAINT, PRESSED = 0.0, 0.007, 0.10
MS = 1_000_000
HELD, PRESS = "PressBegan PressSettled", "PressBegan PressSettled PressEnded"
RELEASED = "PressBegan PressNotSettled:RELEASED PressEnded"


def seen(
    at_ms: float, area: float | None, change: float = 0.0, motion: float = 0.001, sequence: int = -1
) -> Observation:
    """One frame; its sequence is its time in milliseconds unless given."""
    touch = None if area is None else Touch(area)
    return Observation(round(at_ms * MS), int(at_ms) if sequence < 0 else sequence, touch, change, motion)


def run(
    track: Track, frames: Iterable[Observation], rules: ContactSettings = RULES
) -> tuple[Track, list[Event]]:
    events: list[Event] = []
    for frame in frames:
        track, new = step(track, frame, rules)
        events += new
    return track, events


def at(start_ms: int, areas: Iterable[float], spacing_ms: int = 40, change: float = 0.0) -> list[Observation]:
    motion = max(0.001, change)
    return [seen(start_ms + i * spacing_ms, area, change, motion) for i, area in enumerate(areas)]


def free() -> Track:
    return Track(state=State.NO_CONTACT, last_ns=0, still_frames=1, is_confirmed=True)


def unconfirmed() -> Track:
    """A reference that nothing has confirmed, as after a first start."""
    return replace(free(), is_confirmed=False)


def story(events: Iterable[Event]) -> str:
    """Name the events in their order, and why a press did not settle."""
    reasons = (
        (event, f":{event.reason.name}" if isinstance(event, PressNotSettled) else "") for event in events
    )
    return " ".join(type(event).__name__ + reason for event, reason in reasons)


def pressed(at_ms: float, strength: float, motion: float = 0.01, change: float = 0.0) -> Observation:
    """A frame of a press as deep as this; its sequence is its time in milliseconds."""
    return replace(seen(at_ms, PRESSED, change, motion), strength=strength)


def read_view(path: Path) -> View:
    """Read a real picture as small as the rules see it."""
    bgr = cv2.imread(str(path))
    assert bgr is not None
    small = cv2.resize(bgr, (160, 120), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small[..., ::-1]).astype(np.float32)
