"""Where the part lay in a press, as a result states it."""

import math

from pydantic import BaseModel, ConfigDict, Field

from edge.core.registration.registrar import Registered

__all__ = ["PosePlace"]


class PosePlace(BaseModel):
    """Where the part lay, measured from the pose of the bundle's nominal presses, each with its standard deviation."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)

    x_mm: float = Field(description="shift to the right")
    y_mm: float = Field(description="shift down")
    turn_deg: float | None = Field(
        default=None, description="turn, clockwise; null for a part without a turn, as a ball"
    )
    x_sd_mm: float = Field(ge=0)
    y_sd_mm: float = Field(ge=0)
    turn_sd_deg: float | None = Field(default=None, ge=0)
    match: float = Field(description="agreement with the mean nominal press, at most 1")
    unseen_share: float = Field(
        ge=0, le=1, description="of the part, the share outside the inspected region; it is not judged"
    )

    @classmethod
    def of(cls, registered: Registered, mm_per_pixel: tuple[float, float]) -> "PosePlace":
        (x_mm, y_mm), pose, sd = mm_per_pixel, registered.pose, registered.uncertainty
        is_turning = sd.turn_rad is not None
        return cls(
            x_mm=round(pose.x_px * x_mm, 3),
            y_mm=round(pose.y_px * y_mm, 3),
            turn_deg=round(math.degrees(pose.turn_rad), 2) if is_turning else None,
            x_sd_mm=round(sd.x_px * x_mm, 4),
            y_sd_mm=round(sd.y_px * y_mm, 4),
            turn_sd_deg=None if sd.turn_rad is None else round(math.degrees(sd.turn_rad), 3),
            match=round(registered.match, 4),
            unseen_share=round(1 - registered.seen_share, 4),
        )
