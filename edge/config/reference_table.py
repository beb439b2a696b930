"""The table `[reference]` of the configuration: master pieces, when they are due, and what happens out of limits."""

import datetime
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from edge.config.plugin_tables import PlainText, Table

__all__ = ["MasterPieceTable", "ReferenceTable"]


def _time_of_day(value: object) -> object:
    """Parse a time of day such as 06:00. Errors: ValueError for anything else."""
    if isinstance(value, datetime.time):
        return value
    try:
        return datetime.datetime.strptime(str(value), "%H:%M").time()
    except ValueError:
        raise ValueError(f"found {value!r}, expected a time such as '06:00'") from None


class MasterPieceTable(Table):
    """One master piece. It is pressed as a part is, and compared with its own earlier presses."""

    name: PlainText = Field(min_length=1, max_length=64, description="its name or number")
    part: PlainText | None = Field(default=None, description="the part that it is; by default every one")
    position: PlainText | None = Field(
        default=None, description="the position that is pressed; by default every one"
    )
    verdict: Literal["pass", "fail"] = Field(
        default="pass", description="the verdict that it must give: fail for a piece with a known damage"
    )


class ReferenceTable(Table):
    """Reference presses: master pieces that show that station, gel and fixture are as before. See operations.md."""

    pieces: tuple[MasterPieceTable, ...] = Field(default=(), description="the master pieces; one table each")
    enforce: Literal["off", "warn", "refuse"] = Field(
        default="off",
        description="what a reference press that is due or out of limits does. off: nothing; warn: the alarm "
        "`reference`; refuse: the same, and presses of parts are rejected",
    )
    every_h: float = Field(
        default=24.0,
        gt=0,
        le=8760,
        description="hours after which the next one is due; a new gel is due at once",
    )
    shifts: tuple[Annotated[datetime.time, BeforeValidator(_time_of_day)], ...] = Field(
        default=(), description="local times, such as '06:00', from which on the next one is due as well"
    )
    learn: int = Field(
        default=20,
        ge=5,
        le=100,
        description="the first presses of a master piece, of which the limits are made; with fewer, more false alarms",
    )
    within_s: float = Field(
        default=120.0,
        ge=5,
        le=3600,
        description="a reference press that was asked for comes within this time",
    )

    @model_validator(mode="after")
    def _pieces_to_enforce(self) -> "ReferenceTable":
        if self.enforce != "off" and not self.pieces:
            raise ValueError(f'enforce = "{self.enforce}" needs pieces, the master pieces that are pressed')
        names = [piece.name for piece in self.pieces]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"the name '{twice[0]}' is given to two master pieces")
        if faulty := [piece.name for piece in self.pieces if piece.position and not piece.part]:
            raise ValueError(f"the master piece '{faulty[0]}' has a position and no part; name both")
        return self
