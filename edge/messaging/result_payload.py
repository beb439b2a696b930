"""The result of a press, with its pictures, and of a reference press, with its charts: payloads and messages."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Final, Literal, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, JsonValue, model_validator

from edge.core.defects import Defect, longest_extent
from edge.core.imaging.quality import Reason
from edge.core.ports import Message
from edge.core.reference_press.outcome import Outcome, Signal
from edge.core.registration.pose import Registered
from edge.core.verdict import Cause, Kind
from edge.messaging.deviation_payload import DeviationsPayload
from edge.messaging.payload_base import Payload, PressId
from edge.messaging.status_payloads import GelPayload
from edge.pictures.image_file import content_type
from edge.store.gel_ledger import GelRecord

__all__ = [
    "CHARTED",
    "MOST_DEFECTS",
    "ChartEntry",
    "DefectPlace",
    "PosePlace",
    "PressAgainPart",
    "PressFiles",
    "ReferencePayload",
    "ResultPayload",
    "ShadowPart",
    "empty_last_heatmap",
    "picture_messages",
    "press_messages",
]

Pair = tuple[float, float]
Box = tuple[float, float, float, float]

# Parts of one score map that a result describes; the rest is counted in the area alone.
MOST_DEFECTS: Final = 8

_REASONS = " · ".join(f"`{reason}`" for reason in Reason)


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)


class DefectPlace(_Part):
    """A connected part of the score map above the threshold.

    Places are counted from the top left corner of the inspected region, which the picture shows.
    """

    box_px: tuple[int, int, int, int] = Field(description="left, top, width, height")
    box_mm: Box = Field(description="the same in millimetres")
    size_px: float | None = Field(
        default=None,
        ge=0,
        description="the longest extent of it, pixels; in mm, with the depth: `deviations_topic`",
    )
    centroid_px: Pair = Field(description="x, y of its centre of area")
    centroid_mm: Pair = Field(description="the same in millimetres")
    area_mm2: float = Field(ge=0, description="its area in square millimetres")
    score: float = Field(description="the largest score in it")
    region: str | None = Field(default=None, description="the drawn region in which it lies; null for none")

    @classmethod
    def of(cls, defect: Defect, x_mm: float, y_mm: float, region: str | None = None) -> Self:
        """Round it to micrometres: finer than any pixel, and short in JSON. x_mm, y_mm: of a pixel."""
        left, top, width, height = defect.box_px
        x, y = defect.centroid_px
        return cls(
            box_px=defect.box_px,
            box_mm=(
                round(left * x_mm, 3),
                round(top * y_mm, 3),
                round(width * x_mm, 3),
                round(height * y_mm, 3),
            ),
            size_px=round(longest_extent(defect.inside), 1),
            centroid_px=(round(x, 1), round(y, 1)),
            centroid_mm=(round(x * x_mm, 3), round(y * y_mm, 3)),
            area_mm2=round(defect.area_px * x_mm * y_mm, 4),
            score=defect.score,
            region=region,
        )


class PosePlace(_Part):
    """Where the part lay, measured from the pose of the bundle's nominal presses, each with its standard deviation."""

    x_mm: float = Field(description="shift to the right")
    y_mm: float = Field(description="shift down")
    turn_deg: float | None = Field(
        default=None,
        description="turn, clockwise; null for a part without a turn, as a ball",
    )
    x_sd_mm: float = Field(ge=0)
    y_sd_mm: float = Field(ge=0)
    turn_sd_deg: float | None = Field(default=None, ge=0)
    match: float = Field(description="agreement with the mean nominal press, at most 1")
    unseen_share: float = Field(
        ge=0, le=1, description="of the part, the share outside the inspected region; it is not judged"
    )

    @classmethod
    def of(cls, registered: Registered, mm_per_pixel: tuple[float, float]) -> Self:
        (x_mm, y_mm), pose, sd = mm_per_pixel, registered.pose, registered.uncertainty
        turn = registered.turn_rad
        return cls(
            x_mm=round(pose.x_px * x_mm, 3),
            y_mm=round(pose.y_px * y_mm, 3),
            turn_deg=None if turn is None else round(math.degrees(turn), 2),
            x_sd_mm=round(sd.x_px * x_mm, 4),
            y_sd_mm=round(sd.y_px * y_mm, 4),
            turn_sd_deg=None if sd.turn_rad is None else round(math.degrees(sd.turn_rad), 3),
            match=round(registered.match, 4),
            unseen_share=round(1 - registered.seen_share, 4),
        )


class PressAgainPart(_Part):
    """This press asks for a second one of the same piece, or is the second one."""

    is_asked: bool = Field(description="press the same piece again now, a little shifted")
    second_of: PressId | None = Field(default=None, description="`press_id` of the first press of this piece")
    first_score: float | None = Field(default=None, description="its score")
    own_score: float | None = Field(
        default=None,
        description="of this press, where its `score` is what both presses show at one place; null where the lower of "
        "the two scores decides",
    )
    reason: str = Field(description="one sentence")


class ShadowPart(_Part):
    """What another bundle says of this press; it decides nothing."""

    bundle_id: str
    beside: str = Field(description="the bundle that decided")
    verdict: str = Field(description="pass, fail, unsure, or error for a press that it could not score")
    score: float | None = None
    threshold: float


class ResultPayload(Payload):
    """One press, one result. `press_id` is the key: the same result may arrive twice; only `is_replayed` may differ.

    Exactly one of `verdict` and `error` is set: a press that could not be scored has no verdict, and is never a pass.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [
                {"properties": {"verdict": {"type": "null"}, "error": {"type": "string"}}},
                {"properties": {"verdict": {"type": "string"}, "error": {"type": "null"}}},
            ]
        }
    )

    press_id: PressId
    is_replayed: bool = Field(
        default=False, description="sent late, from the outbox; `time` is that of the press"
    )
    sequence: int | None = Field(
        default=None,
        ge=1,
        description="rises by one with every press of this station's database; restarts and changes of gel do not "
        "reset it: a missing number is a missed result",
    )
    site: str | None = Field(default=None, description="where it was pressed, as in the topic")
    line: str | None = None
    station: str | None = None
    part: str
    position: str | None = None
    verdict: Kind | None = None
    reason: str | None = Field(
        default=None, description=f"why it is rejected: {_REASONS}; a colon; a sentence"
    )
    error: str | None = Field(default=None, description="why there is no verdict")
    score: float | None = Field(default=None, description="raw, higher is more anomalous; see `press_again`")
    threshold: float | None = Field(default=None, description="scores above it fail")
    tolerance: float | None = Field(
        default=None, ge=0, description="scores this near the threshold are unsure"
    )
    score_ratio: float | None = Field(
        default=None, description="score / threshold: above 1 fails, with every detector"
    )
    defects: list[DefectPlace] | None = Field(
        default=None,
        description="where the score map is above the threshold (of a second press with `own_score`: above 0.95 of "
        "it), highest score first, "
        f"at most {MOST_DEFECTS}; null for a pass and for a press without a score",
    )
    defect_area_mm2: float | None = Field(
        default=None,
        ge=0,
        description="all of the map above the threshold, also the parts that `defects` omits",
    )
    mm_per_pixel: Pair | None = Field(default=None, description="x, y of the picture")
    cause: Cause | None = Field(
        default=None,
        description="of a fail or unsure: part, gel (a scar or something on it), or unsure; null for other verdicts",
    )
    cause_text: str | None = Field(default=None, description="why this cause, one sentence")
    blind_area_mm2: float | None = Field(
        default=None,
        ge=0,
        description="of the contact, lies under known scars of the gel and was not judged; null without a score",
    )
    blind_share: float | None = Field(
        default=None, ge=0, le=1, description="the same as a share of the contact"
    )
    unmasked_score: float | None = Field(
        default=None,
        description="the score with the places under scars and beyond the part; null where none was left out",
    )
    is_at_rest: bool | None = Field(
        default=None,
        description="whether the press rested when it was judged; false where it grew or moved until it was lifted: "
        "its peak was judged; null without a frame to judge",
    )
    light_gain: tuple[float, float, float] | None = Field(
        default=None,
        description="red, green, blue: by how much the press was made brighter before its score, because the free gel "
        "shows the light of the fit no more; null where it was scored as it is",
    )
    method: str | None = None
    bundle_id: str | None = None
    sensor_serial: str
    gel_id: str
    gel_serial: str | None = Field(default=None, description="the gel's own, as in `gel`")
    gel_presses: int = Field(ge=0, description="presses of this gel, including this one")
    gel_limit_presses: int = Field(ge=1)
    latency_ms: dict[str, float] = Field(
        default_factory=dict,
        description="stage to milliseconds; `total` is rest to verdict, stages may run before",
    )
    heatmap_topic: str | None = Field(
        default=None, description="where this press's picture is sent, below the root"
    )
    overview_topic: str | None = Field(
        default=None, description="where the overview camera's still is sent, below the root"
    )
    deviations_topic: str | None = Field(
        default=None,
        description="where sizes and depths of `defects` in mm are sent, below the root; null for a gel whose heights "
        "are not calibrated, and where there is nothing to measure",
    )
    part_codes: list[str] | None = Field(
        default=None, description="codes read on the part before the press; null without an overview camera"
    )
    part_present: bool | None = Field(
        default=None, description="whether the overview camera saw a part; null where it is not asked"
    )

    pose: PosePlace | None = Field(default=None, description="where the part lay; null where none is sought")
    press_again: PressAgainPart | None = Field(
        default=None, description="one more press of the same piece: asked for, or this one; null for neither"
    )
    shadow: ShadowPart | None = Field(
        default=None, description="what the shadow bundle says; null without one"
    )
    piece_id: str | None = Field(
        default=None,
        description="the piece of several places that it is of; its verdict is in `piece_result`, and a pass here is "
        "that of one place",
    )
    place: str | None = Field(
        default=None, description="the place of the piece, part/position; null for a press that fills none"
    )
    trigger_id: int | None = Field(
        default=None,
        ge=1,
        description="of the PLC's trigger that this press answered; the PLC has seen a pass only where it was recorded "
        "in time; null for none",
    )
    feature: dict[str, dict[str, JsonValue]] = Field(
        default_factory=dict,
        description="what features of other packages say of this press, by their names",
    )
    ledger_head: str | None = Field(
        default=None,
        description="the newest link of the ledger, with this press: `gelgate db check` compares it with the ledger",
    )

    @model_validator(mode="after")
    def _verdict_or_error(self) -> Self:
        if (self.verdict is None) == (self.error is None):
            raise ValueError("a result has a verdict or an error, exactly one of them")
        if self.verdict in (Kind.PASS, Kind.FAIL, Kind.UNSURE) and (
            self.score is None or self.threshold is None
        ):
            raise ValueError(f"the verdict '{self.verdict}' needs a score and a threshold")
        return self


class PressFiles(NamedTuple):
    """The pictures of one press, as files; empty ones where there are none."""

    sheet: bytes = b""
    """For people: PNG or JPEG."""
    score_map: bytes = b""
    """For programs: PNG."""
    deviations: DeviationsPayload | None = None
    """What was measured of it; None where nothing is measured."""


def picture_messages(press_id: str, files: PressFiles, *, is_last: bool = False) -> Sequence[Message]:
    """The pictures of one press. The press id is in the topic, which both protocol levels can carry. is_last: the sheet
    is the retained picture too."""
    sheet_type = content_type(files.sheet) if files.sheet else "image/jpeg"
    sheet = Message(f"heatmap/{press_id}", files.sheet, qos=1, content_type=sheet_type)
    return [
        *([] if files.deviations is None else [files.deviations.message()]),
        Message(f"scoremap/{press_id}", files.score_map, qos=1, content_type="image/png"),
        sheet,
        *([replace(sheet, topic="last/heatmap", retain=True)] if is_last else []),
    ]


def empty_last_heatmap() -> Message:
    """Removes the retained picture from the broker."""
    return Message("last/heatmap", b"", qos=1, retain=True, content_type="image/jpeg")


def press_messages(
    result: ResultPayload,
    gel: GelRecord,
    overview_jpeg: bytes | None = None,
    *,
    keeps_heatmap: bool = False,
) -> Sequence[Message]:
    """The first messages of one press, in order: result, the still before it, then the retained result on its two
    topics, and `gel`. Its pictures follow (`picture_messages`).

    keeps_heatmap: the newest picture is retained. It is that of an older press until the new one comes, so that a
    dashboard sees one change for each press; a press that has none empties the topic before its retained result.
    """
    encoded, press_id = result.encode(), result.press_id
    still = Message(f"overview/{press_id}", overview_jpeg or b"", qos=1, content_type="image/jpeg")
    return [
        Message("result", encoded, qos=1),
        *([] if overview_jpeg is None else [still]),
        *([empty_last_heatmap()] if keeps_heatmap and result.heatmap_topic is None else []),
        Message("last", encoded, qos=1, retain=True),
        Message("last/press", encoded, qos=1, retain=True),
        GelPayload.of(gel, result.time_ns).message(),
    ]


# The newest values of each chart that a message has: enough to draw it, and 6 kB at most.
CHARTED: Final = 50


class ChartEntry(_Part):
    """One control chart of individual values."""

    measure: str = Field(description="score, strength_levels, x_mm, y_mm, turn_deg or noise_levels")
    unit: str
    values: list[float] = Field(description=f"oldest first, the newest {CHARTED}")
    time_ns: list[int] = Field(description="of each value, wall clock, nanoseconds since 1970 UTC")
    low: float | None = Field(default=None, description="the lower limit; null while limits are learnt")
    centre: float | None = None
    high: float | None = None
    learnt: int = Field(ge=0, description="presses that the limits are made from so far")
    learn: int = Field(ge=2, description="presses that they are made from")
    signals: list[Signal] = Field(description="what the newest value says")


class ReferencePayload(Payload):
    """A press of a master piece. It is no part's, and counts on the gel."""

    topic: ClassVar = "reference"
    kind: Literal["reference"] = "reference"
    is_replayed: bool = Field(default=False, description="sent late, from the outbox")
    press_id: str
    number: int = Field(ge=1, description="of the reference presses of this station's database")
    piece: str = Field(description="the master piece")
    part: str
    position: str | None = None
    outcome: Outcome = Field(
        description="learning: limits are not known yet; warning: a run rule; not_measured: rejected, or no score"
    )
    sentences: list[str] = Field(description="what was found, and what to do")
    verdict: str = Field(description="pass, fail, unsure, rejected or error")
    expected: str = Field(description="the verdict that this master piece must give")
    score: float | None = None
    threshold: float | None = None
    bundle_id: str
    sensor_serial: str
    gel_id: str
    gel_presses: int = Field(ge=0, description="presses of this gel, including this one")
    heatmap_topic: str | None = Field(
        default=None, description="where this press's picture is sent, below the root"
    )
    charts: list[ChartEntry]
