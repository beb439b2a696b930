"""The events of contact detection: a reference is ready, a press began, settled or did not, and ended."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.contact.reference import View
from edge.core.contact.relief import Relief
from edge.core.contact.table import State
from edge.core.imaging.frames import CameraFrame

__all__ = [
    "Event",
    "Findings",
    "NotSettledReason",
    "PressBegan",
    "PressEnded",
    "PressNotSettled",
    "PressSettled",
    "ReferenceCorrected",
    "ReferenceDoubted",
    "ReferenceReady",
    "ReferenceRefreshed",
    "StartedTouched",
    "TriggerRepeated",
    "TriggerWithoutContact",
]


class NotSettledReason(StrEnum):
    """Why a press gave no frame to score."""

    RELEASED = "released before it was still"
    TIMED_OUT = "not still in time"
    NOT_TRIGGERED = "released before a trigger asked for it"
    DOUBTED = "the learnt picture of the free gel proved wrong"
    RELEARNT = "a new reference was asked for during the press"


@dataclass(frozen=True)
class _Moment:
    timestamp_ns: int


class ReferenceReady(_Moment):
    """A reference was learnt; presses are seen from now on."""


class ReferenceDoubted(_Moment):
    """The reference was most likely learnt while something pressed; nothing is scored until it is corrected."""


class ReferenceCorrected(_Moment):
    """The free gel was seen, and is the reference now; `ReferenceReady` follows."""


@dataclass(frozen=True)
class ReferenceRefreshed(_Moment):
    """The reference followed the free gel."""

    change: float
    """Mean absolute difference, levels."""


@dataclass(frozen=True)
class StartedTouched(_Moment):
    """At the start the view differs from the stored reference as if pressed; nothing counts until it is free.

    If nothing presses, the gel was changed without a record: record the change and learn a new reference.
    """

    area: float


@dataclass(frozen=True)
class PressBegan(_Moment):
    """A contact was confirmed."""

    sequence: int
    """The frame that confirmed it."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What the frame of a settled press shows, against the free gel, in the view of contact detection."""

    mask: NDArray[np.bool_]
    """The touched area, where it is light by its relief: (h, w)."""
    level: View
    """The view at the level of the free gel, float32 (h, w, 3)."""
    free: View
    """The free gel, float32 (h, w, 3)."""
    relief: Relief
    """The fine structure that the press adds."""
    noise_levels: float | None
    """One standard deviation of one value of a view of the free gel; None where it was not seen free three times."""

    @property
    def imprint(self) -> View:
        """Return what the press adds to the free gel, levels, float32 (h, w, 3)."""
        return np.asarray(self.level - self.free, np.float32)


@dataclass(frozen=True)
class PressSettled:
    """The press rests: score frame `sequence`, the deepest one at rest. Once per press.

    touch, strength: of the frame to score; strength grows with depth, levels.
    """

    timestamp_ns: int
    """The time of the frame that decided."""
    sequence: int
    began_ns: int
    """The time of `PressBegan`."""
    touch: Touch
    strength: float = 0.0
    is_held: bool = True
    """False for one that is judged at its peak, after it was lifted."""
    findings: Findings | None = field(default=None, repr=False)
    """What the tracker adds to the event."""
    frame: CameraFrame | None = field(default=None, repr=False)
    """The one to score, added by the detector."""


@dataclass(frozen=True)
class PressEnded(_Moment):
    """The gel is free again, after a press that gave one of the two verdict events."""

    sequence: int
    began_ns: int


@dataclass(frozen=True)
class PressNotSettled(_Moment):
    """The press gives no frame to score; it counts for the gel and is rejected. Once per press."""

    sequence: int
    began_ns: int
    reason: NotSettledReason


@dataclass(frozen=True)
class TriggerWithoutContact:
    """A trigger came while nothing pressed."""

    state: State


@dataclass(frozen=True)
class TriggerRepeated:
    """A trigger came for a press that already has its verdict."""

    state: State


Event = (
    ReferenceReady
    | ReferenceDoubted
    | ReferenceCorrected
    | ReferenceRefreshed
    | StartedTouched
    | PressBegan
    | PressSettled
    | PressNotSettled
    | PressEnded
    | TriggerWithoutContact
    | TriggerRepeated
)
