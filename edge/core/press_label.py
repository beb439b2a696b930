"""What a press is for, where it is not a part's: a master piece's, or one of a gauge study."""

from dataclasses import dataclass

__all__ = ["PressLabel", "ReferenceLabel", "StudyLabel"]


@dataclass(frozen=True)
class ReferenceLabel:
    """A master piece."""

    piece: str
    expected: str
    """The verdict that it must give."""
    learn: int
    """Presses that its limits are made from."""
    is_start: bool = False
    """Its charts begin again."""

    @property
    def kind(self) -> str:
        return "reference"


@dataclass(frozen=True)
class StudyLabel:
    """One step of the plan of a gauge study; repeat counts from 1."""

    study_id: str
    step: int
    piece: str
    operator: str
    repeat: int

    @property
    def kind(self) -> str:
        return "study"


PressLabel = ReferenceLabel | StudyLabel
