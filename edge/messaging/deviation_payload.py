"""The deviations of a press in millimetres: a message of its own, for measuring takes longer than a result may."""

from typing import ClassVar, Self

from pydantic import BaseModel, Field

from edge.core.defects import Deviation
from edge.core.ports import Message
from edge.messaging.payload_base import Payload, PressId

__all__ = ["DeviationPlace", "DeviationsPayload"]


class DeviationPlace(BaseModel, strict=True, frozen=True, extra="forbid", allow_inf_nan=False):
    """One deviation. What is null is not told from its error."""

    depth_mm: float | None = Field(
        default=None,
        description="how much deeper the part is there than a good one; below 0 where it stands out",
    )
    depth_u95_mm: float | None = Field(
        default=None,
        ge=0,
        description="by how much the depth may be wrong, 95 %; without a depth, how deep it may be",
    )
    size_mm: float | None = Field(
        default=None, ge=0, description="the longest extent of what is above half of the depth"
    )
    size_u95_mm: float | None = Field(
        default=None, ge=0, description="by how much the size may be wrong, 95 %"
    )
    remark: str | None = Field(default=None, description="why something is null, or less sure than it looks")

    @classmethod
    def of(cls, deviation: Deviation) -> Self:
        return cls(**{**vars(deviation), "remark": deviation.remark or None})

    def __str__(self) -> str:
        phrases = [
            f"{name} {value:.3f} +- {u95:.3f} mm"
            for name, value, u95 in (
                ("depth", self.depth_mm, self.depth_u95_mm),
                ("size", self.size_mm, self.size_u95_mm),
            )
            if value is not None
        ]
        return ", ".join(phrases)


class DeviationsPayload(Payload):
    """The deviations of one press, measured by a calibrated sensor after its result."""

    topic: ClassVar = "deviations"
    is_retained: ClassVar = False
    press_id: PressId
    calibration: str = Field(description="name of the gel's calibration")
    reason: str | None = Field(default=None, description="why nothing was measured, one sentence; null else")
    deviations: list[DeviationPlace] = Field(description="in the order of the result's `defects`")

    @property
    def first(self) -> DeviationPlace:
        """The deviation of the highest score, empty where nothing was measured."""
        return self.deviations[0] if self.deviations else DeviationPlace()

    def message(self) -> Message:
        return Message(f"{self.topic}/{self.press_id}", self.encode(), self.qos, self.is_retained)
