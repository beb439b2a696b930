"""Every topic below a station's root: delivery, retention, payload and purpose. Pages, rules and schemas follow it."""

from typing import Final, NamedTuple

from pydantic import BaseModel

from edge.messaging.alarm_payload import AlarmPayload
from edge.messaging.command_payloads import CommandRequest, CommandResponse
from edge.messaging.deviation_payload import DeviationsPayload
from edge.messaging.payload_base import Payload
from edge.messaging.piece_payloads import PiecePayload, PieceResultPayload
from edge.messaging.result_payload import ReferencePayload, ResultPayload
from edge.messaging.status_payloads import (
    ContactPayload,
    DriftPayload,
    GelPayload,
    InfoPayload,
    QuestionsPayload,
    StatePayload,
    StatsPayload,
)

__all__ = ["TOPICS", "Topic"]


class Topic(NamedTuple):
    """name: below the root; `<...>` stands for one level. payload: a model, or a word for what has none. may_be_empty:
    when there is nothing, the retained message is removed."""

    name: str
    qos: int
    is_retained: bool
    payload: type[BaseModel] | str
    meaning: str
    may_be_empty: bool = False


def _own(payload: type[Payload], meaning: str, *, may_be_empty: bool = False) -> Topic:
    """Make the topic of a payload that says its delivery itself."""
    return Topic(payload.topic, payload.qos, payload.is_retained, payload, meaning, may_be_empty)


TOPICS: Final[tuple[Topic, ...]] = (
    _own(StatePayload, "whether the station inspects; also the last will"),
    Topic(
        "availability", 1, True, "text", "`online` or `offline`: whether the gateway runs; also a last will"
    ),
    _own(InfoPayload, "the installed software, bundle and sensor"),
    Topic(
        "asyncapi", 1, True, "AsyncAPI", "this page for programs: AsyncAPI 3 with the schema of every payload"
    ),
    Topic("result", 1, False, ResultPayload, "one message per press"),
    Topic(
        "heatmap/<press id>",
        1,
        False,
        "picture",
        "the picture of one press for people, after its result, whose id it has; empty where there is none",
        may_be_empty=True,
    ),
    Topic(
        "scoremap/<press id>",
        1,
        False,
        "PNG",
        "the scores of one press for programs, just before its `heatmap`; empty where there are none",
        may_be_empty=True,
    ),
    Topic(
        "deviations/<press id>",
        1,
        False,
        DeviationsPayload,
        "sizes and depths of a press's `defects` in mm, just before its `scoremap`; only of a calibrated gel",
    ),
    Topic(
        "overview/<press id>", 1, False, "JPEG", "the overview camera's still of the part before the press"
    ),
    Topic("last/press", 1, True, ResultPayload, "the newest result, on a fixed topic for dashboards"),
    Topic(
        "last/heatmap",
        1,
        True,
        "picture",
        "the newest `heatmap` of a part, on a fixed topic for dashboards; only with `last_heatmap`, otherwise empty",
        may_be_empty=True,
    ),
    Topic("last", 1, True, ResultPayload, "the same as `last/press`, for subscribers of version 0.1"),
    _own(
        ReferencePayload,
        "the newest reference press with its control charts; such a press is on no other topic but `heatmap`",
    ),
    _own(ContactPayload, "what the contact is, for a robot or a hand; the newest alone counts"),
    _own(GelPayload, "wear of the mounted gel"),
    _own(PiecePayload, "the piece of several places in progress; only with `[piece]`", may_be_empty=True),
    _own(PieceResultPayload, "one message per piece of several places"),
    _own(QuestionsPayload, "presses that a person is asked about"),
    _own(DriftPayload, "control charts of the passing presses"),
    Topic("alarm/<alarm>", 1, True, AlarmPayload, "raised alarms; emptied when over", may_be_empty=True),
    _own(StatsPayload, "counters, for dashboards"),
    Topic("cmd/<verb>", 1, False, CommandRequest, "requests to the station; never retained"),
    Topic("cmd/<verb>/response", 1, False, CommandResponse, "the answer, with the request's transaction"),
)
