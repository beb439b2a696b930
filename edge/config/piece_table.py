"""The table `[piece]` of the configuration: the places of a piece, and how long it may take."""

from typing import Literal

from pydantic import Field, model_validator

from edge.config.plugin_tables import PlainText, Table
from edge.core.part_position import PartPosition

__all__ = ["PieceTable", "PlaceTable"]


class PlaceTable(Table):
    """One place of a piece."""

    part: PlainText = Field(description="as in its bundle")
    position: PlainText = Field(description="as in its bundle")


class PieceTable(Table):
    """A piece that is pressed at several places and has one verdict, `piece_result`: see operations.md."""

    places: tuple[PlaceTable, ...] = Field(
        min_length=1, description="what is pressed of every piece; one table each"
    )
    order: Literal["free", "fixed"] = Field(
        default="free",
        description="fixed: in the order of `places`, each of which is selected when the one before is done; free: in "
        "any order, and the selected part is the place that is pressed",
    )
    within_s: float = Field(
        default=120.0,
        ge=1,
        le=86400,
        description="a piece that is not complete this long after its begin is `incomplete`",
    )

    @property
    def plan(self) -> tuple[PartPosition, ...]:
        return tuple(PartPosition(one.part, one.position) for one in self.places)

    @model_validator(mode="after")
    def _each_place_once(self) -> "PieceTable":
        if twice := sorted({str(place) for place in self.plan if self.plan.count(place) > 1}):
            raise ValueError(
                f"the place {twice[0]} is named twice, expected once; a second look at it is a bundle with a position "
                "of its own"
            )
        return self
