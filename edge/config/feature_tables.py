"""The tables of single features: overview camera, pieces of several places, master pieces, requests, counters."""

import datetime
import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from edge.config.plugin_tables import PlainText, PluginTable, Table
from edge.core.overview.view import PRESENT_SHARE, CodeKind, TagFamily, Zone
from edge.core.part_position import PartPosition

__all__ = [
    "CommandTable",
    "ConfirmTable",
    "MasterPieceTable",
    "MetricsTable",
    "OverviewTable",
    "PieceTable",
    "ReferenceTable",
]


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
        return tuple(PartPosition(place.part, place.position) for place in self.places)

    @model_validator(mode="after")
    def _each_place_once(self) -> "PieceTable":
        if twice := sorted({str(place) for place in self.plan if self.plan.count(place) > 1}):
            raise ValueError(
                f"the place {twice[0]} is named twice, expected once; a second look at it is a bundle with a position "
                "of its own"
            )
        return self


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


class ConfirmTable(Table):
    """What people are asked about, where `confirm_press` is served: see operations.md."""

    questions_per_day: int = Field(
        default=10,
        ge=0,
        le=100,
        description="presses that a person is asked about on one day, at most; 0: none",
    )


class MetricsTable(Table):
    """Counters for Prometheus, on this machine alone: http://127.0.0.1:<port>/metrics. Needs the extra `metrics`."""

    port: int | None = Field(default=None, ge=1024, le=65535, description="TCP port; none: not served")


class CommandTable(Table):
    """Which requests are served, and from whom; all others are refused. mqtt.md has the verbs."""

    unsigned: tuple[str, ...] = Field(
        default=("trigger",),
        description="verbs for everybody whom the broker lets publish on `cmd/<verb>`: its access rules decide",
    )
    signed: tuple[str, ...] = Field(
        default=(),
        description="verbs that need a signature with the secret, such as `relearn` and `replace_gel`",
    )
    secret_file: Path | None = Field(
        default=None, description="file that holds only the secret, at least 16 bytes, rights 0640"
    )
    page: tuple[str, ...] = Field(
        default=("select_part", "begin_piece", "acknowledge_alarm", "replace_gel", "confirm_press"),
        description="verbs for a person at the sink `page` who has its token; without a token none is served there",
    )
    requests_per_minute: int = Field(
        default=60,
        ge=1,
        le=6000,
        description="of signed, unsigned and page requests each, of all verbs together; more are refused",
    )

    @model_validator(mode="after")
    def _secret_for_signed(self) -> "CommandTable":
        if self.signed and self.secret_file is None:
            raise ValueError("signed verbs need secret_file")
        if both := sorted(set(self.signed) & set(self.unsigned)):
            raise ValueError(f"{', '.join(both)}: a verb is signed or unsigned, not both")
        return self
