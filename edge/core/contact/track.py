"""The memory of contact detection between frames."""

from dataclasses import dataclass, field

from edge.core.contact.settled_frame import Window
from edge.core.contact.table import State

__all__ = ["IDLE", "LEARNING", "PRESSED", "UNJUDGED", "WATCHED", "Track"]

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
    adds_structure: bool = False
    is_interrupted: bool = False
    blind_until_ns: int = 0

    @property
    def has_contact(self) -> bool:
        """True from `PressBegan` to `PressEnded`, and for a part that was there at the start."""
        return self.state in PRESSED
