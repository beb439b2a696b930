"""One more press of the same piece, as a result states it."""

from pydantic import BaseModel, ConfigDict, Field

from edge.messaging.payload_base import PressId

__all__ = ["PressAgainPart"]


class PressAgainPart(BaseModel):
    """This press asks for a second one of the same piece, or is the second one."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)

    is_asked: bool = Field(description="press the same piece again now, a little shifted")
    second_of: PressId | None = Field(default=None, description="`press_id` of the first press of this piece")
    first_score: float | None = Field(default=None, description="its score; the lower of the two is decided")
    reason: str = Field(description="one sentence")
