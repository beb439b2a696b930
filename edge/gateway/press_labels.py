"""What the loop and the press pipeline ask before a press is judged: is it a part's, and may a part be judged now?"""

from dataclasses import dataclass
from typing import Protocol

from edge.core.gel_proof import MadeOn
from edge.core.imaging.quality import Rejection
from edge.core.part_position import PartPosition
from edge.core.press_label import PressLabel

__all__ = ["Mounted", "PressLabels"]


@dataclass(frozen=True)
class Mounted:
    """What a press would be made with now. has_contact: something presses the gel. made: the bundle's own gel."""

    serial: str
    gel_id: str
    part: PartPosition
    bundle_id: str
    has_contact: bool
    made: MadeOn


class PressLabels(Protocol):
    """Used by the loop alone. Errors of `step`: StoreError."""

    def step(self, mounted: Mounted | None) -> None:
        """One turn of the loop; None before the sensor is known."""

    def begin(self) -> PressLabel | None:
        """A press begins: what it is for, None for a part's."""

    def refusal(self) -> Rejection | None:
        """Why a part's press is not judged now."""

    def recorded(self, label: PressLabel) -> None:
        """A press with a label is in the database."""
