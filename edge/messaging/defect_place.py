"""The place of a defect in a result."""

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["DefectPlace", "Pair"]

Pair = tuple[float, float]
Box = tuple[float, float, float, float]


class DefectPlace(BaseModel):
    """A connected part of the score map above the threshold.

    Places are counted from the top left corner of the inspected region, which the picture shows.
    """

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)

    box_px: tuple[int, int, int, int] = Field(description="left, top, width, height")
    box_mm: Box = Field(description="the same in millimetres")
    centroid_px: Pair = Field(description="x, y of its centre of area")
    centroid_mm: Pair = Field(description="the same in millimetres")
    area_mm2: float = Field(ge=0, description="its area in square millimetres")
    score: float = Field(description="the largest score in it")
