"""The table `[overview]` of the configuration: an overview camera, and what its still must show before a press."""

import re
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from edge.config.plugin_tables import PluginTable
from edge.core.overview.view import PRESENT_SHARE, CodeKind, TagFamily, Zone

__all__ = ["OverviewTable"]


def _check_pattern(pattern: str) -> str:
    """Check the pattern. Errors: ValueError for one that is not valid, or has no group `part`."""
    try:
        groups = re.compile(pattern).groupindex
    except re.error as error:
        raise ValueError(f"it is no regular expression: {error}") from error
    if "part" not in groups:
        raise ValueError("it has no group `part`; write one, such as (?P<part>[^;]+);.*")
    return pattern


class OverviewTable(PluginTable):
    """A camera that sees the part before the press. Its still goes with each result; with `codes` or `empty` a press
    is refused unless the selected part is there."""

    codes: tuple[CodeKind, ...] = Field(
        default=(),
        description="kinds of code to read on the part: qr, apriltag, datamatrix (extra `datamatrix`); without any no "
        "id is asked for",
    )
    apriltag_family: TagFamily = Field(default="36h11", description="the family of the AprilTags")
    part_pattern: Annotated[str, AfterValidator(_check_pattern)] | None = Field(
        default=None,
        description="regular expression of the complete text of a code; its group `part` is the part, by default all, "
        "and its group `piece`, where it has one, the id of the piece",
    )
    parts: dict[str, str] = Field(
        default_factory=dict,
        description="text of a code, or its group `part`, to the part or a name of a bundle, where the two differ",
    )
    select: bool = Field(
        default=False,
        description="the code on the part selects its bundle when a press begins; by default another part is refused",
    )
    empty: Path | None = Field(
        default=None, description="picture of the empty station: a part must differ from it"
    )
    present_share: float = Field(
        default=PRESENT_SHARE,
        gt=0,
        le=1,
        description="a part changes at least this share of the region",
    )
    region: list[float] = Field(
        default=[0.0, 0.0, 1.0, 1.0],
        min_length=4,
        max_length=4,
        description="where the part is: left, top, width, height in fractions of the picture",
    )
    max_age_s: float = Field(
        default=2.0, gt=0, le=60, description="an older picture says nothing of this press, seconds"
    )
    max_side_px: int = Field(
        default=1280,
        ge=64,
        le=8192,
        description="larger stills are made smaller before they are read and sent",
    )

    @property
    def reads_pieces(self) -> bool:
        """Whether its codes begin pieces."""
        return self.part_pattern is not None and "piece" in re.compile(self.part_pattern).groupindex

    @model_validator(mode="after")
    def _fits_together(self) -> "OverviewTable":
        Zone(*self.region)
        if not self.codes and (self.parts or self.part_pattern is not None or self.select):
            raise ValueError("parts, part_pattern and select need codes, the kinds of code to read")
        return self
