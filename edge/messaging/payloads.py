"""The published messages: one pydantic model per payload, and the topic, delivery and retention of each.

What all of them have is in `payload_base`.
Units are in the names. Within version 1 fields may be added; a subscriber ignores those it does not know.
docs/mqtt.md is printed from this file.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Final, Literal, Self

from pydantic import ConfigDict, Field, StringConstraints, model_validator

from edge.core.gel import GelState
from edge.core.imaging.quality import Reason
from edge.core.ports import Message
from edge.core.verdict import Kind
from edge.messaging.defect_place import DefectPlace, Pair
from edge.messaging.payload_base import Payload, iso_time
from edge.messaging.pose_payload import PosePlace
from edge.store.gel_ledger import GelRecord

__all__ = [
    "ALARMS",
    "MOST_DEFECTS",
    "AlarmPayload",
    "DefectPlace",
    "GelPayload",
    "InfoPayload",
    "Payload",
    "ResultPayload",
    "StatePayload",
    "StatsPayload",
    "alarm_cleared",
    "alarm_message",
    "as_replayed",
    "availability_message",
    "gel_message",
    "heatmap_message",
    "info_message",
    "iso_time",
    "overview_message",
    "press_messages",
    "state_message",
    "stats_message",
]

# Parts of one score map that a result describes; the rest is counted in the area alone.
MOST_DEFECTS: Final = 8

PressId = Annotated[str, StringConstraints(pattern=r"^[0-7][0-9A-HJKMNP-TV-Z]{25}$")]

ALARMS: Final[Mapping[str, str]] = {
    "device": "the sensor is missing, stalled or sends broken frames",
    "store": "the database or its disk refuses writes; inspection halts",
    "disk": "the disk of the database has little room left; when it is full, inspection halts",
    "outbox_full": "unsent messages were dropped: too old, or no room; heatmaps first, passes next, fails last",
    "refused": "a receiver refused a message; it is kept and offered again within a minute",
    "receiver": "a receiver works, with a fault that a person should correct: denied topics, its MQTT level, client id",
    "counts": "the database knew less than the second record of the counts: it was removed, damaged or replaced",
    "free_gel": "the free gel was learnt while something pressed; nothing is scored until the free gel is seen at rest",
    "bundle": "a configured bundle cannot be used, or is older than one that was; the ones in use go on inspecting",
    "golden": "the golden frames of the bundle in use score otherwise than at its fit; no press has a verdict",
    "overview": "the overview camera gives no pictures: presses are refused where it must see the part",
    "overload": "this machine is too slow for its frames: some were dropped or judged too late, presses may be missed",
    "gel": "the gel is due or must be replaced",
    "trigger_device": "a pedal or button cannot be used",
    "actuator": "a light or relay cannot be used, or its watchdog has put it into its safe state",
    "pulse": "a pulse was not given in time: a part may have passed; stays until acknowledged, or a restart",
}
"""Alarm id to meaning. All are cleared at start, so that no alarm outlives the process that raised it."""


class StatePayload(Payload):
    """Whether the station inspects. The broker itself publishes `lost` (the last will) when the gateway vanishes."""

    state: Literal["starting", "ready", "halted", "stopped", "lost"] = Field(
        description="starting: not yet inspecting; ready: inspecting; halted: running but unable to inspect, see "
        "`reason`; stopped: ended on purpose; lost: ended without a message (`time` is then that of its start)"
    )
    reason: str | None = Field(default=None, description="one sentence, for people")


class InfoPayload(Payload):
    """The installed software, bundle and sensor."""

    gelgate_version: str
    sensor_product: str | None = None
    sensor_serial: str | None = None
    sensor_profile: str | None = None
    part: str | None = None
    position: str | None = None
    parts: tuple[str, ...] = Field(
        default=(), description="what `cmd/select_part` can select, each a `name`: part/position"
    )
    method: str | None = Field(default=None, description="detector of the bundle in use")
    backbone: str | None = None
    bundle_id: str | None = Field(default=None, description="SHA-256 of the bundle's manifest")
    revision: int | None = Field(default=None, ge=1, description="of the bundle; it rises with every fit")
    threshold: float | None = None
    false_alarms: str | None = Field(default=None, description="the promise of the threshold, in words")
    warnings: tuple[str, ...] = Field(
        default=(), description="the warnings of `fit`, such as an outlier among the presses"
    )


_REASONS = " · ".join(f"`{reason}`" for reason in Reason)


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
    score: float | None = Field(default=None, description="raw anomaly score, higher is more anomalous")
    threshold: float | None = Field(default=None, description="scores above it fail")
    tolerance: float | None = Field(
        default=None, ge=0, description="scores this near the threshold are unsure"
    )
    score_ratio: float | None = Field(
        default=None, description="score / threshold: above 1 fails, with every detector"
    )
    defects: list[DefectPlace] | None = Field(
        default=None,
        description="where the score map is above the threshold, highest score first, "
        f"at most {MOST_DEFECTS}; null for a pass and for a press without a score",
    )
    defect_area_mm2: float | None = Field(
        default=None,
        ge=0,
        description="all of the map above the threshold, also the parts that `defects` omits",
    )
    mm_per_pixel: Pair | None = Field(default=None, description="x, y of the picture")
    method: str | None = None
    bundle_id: str | None = None
    sensor_serial: str
    gel_id: str
    gel_presses: int = Field(ge=0, description="presses of this gel, including this one")
    gel_limit_presses: int = Field(ge=1)
    latency_ms: dict[str, float] = Field(
        default_factory=dict, description="stage to milliseconds; `total` is frame to verdict"
    )
    heatmap_topic: str | None = Field(
        default=None, description="where this press's picture is sent, below the root"
    )
    overview_topic: str | None = Field(
        default=None, description="where the overview camera's still is sent, below the root"
    )
    part_codes: list[str] | None = Field(
        default=None, description="codes read on the part before the press; null without an overview camera"
    )
    part_present: bool | None = Field(
        default=None, description="whether the overview camera saw a part; null where it is not asked"
    )

    pose: PosePlace | None = Field(default=None, description="where the part lay; null where none is sought")

    @model_validator(mode="after")
    def _verdict_or_error(self) -> Self:
        if (self.verdict is None) == (self.error is None):
            raise ValueError("a result has a verdict or an error, exactly one of them")
        if self.verdict in (Kind.PASS, Kind.FAIL, Kind.UNSURE) and (
            self.score is None or self.threshold is None
        ):
            raise ValueError(f"the verdict '{self.verdict}' needs a score and a threshold")
        return self


class GelPayload(Payload):
    """The wear of the mounted gel."""

    is_replayed: bool = False
    sensor_serial: str
    gel_id: str
    presses: int = Field(ge=0)
    limit_presses: int = Field(ge=1)
    state: GelState = Field(description="good, due (order one), replace (at the limit, or optically worn)")
    wear_index: float | None = Field(default=None, description="optical wear: 0 as new, 1 to be replaced")
    first_use_ns: int | None = None
    last_use_ns: int | None = None

    @classmethod
    def of(cls, gel: GelRecord, time_ns: int) -> Self:
        return cls(
            time_ns=time_ns,
            sensor_serial=gel.serial,
            gel_id=gel.gel_id,
            presses=gel.presses,
            limit_presses=gel.limit_presses,
            state=gel.state,
            wear_index=gel.wear_index,
            first_use_ns=gel.first_use_ns,
            last_use_ns=gel.last_use_ns,
        )


class AlarmPayload(Payload):
    """A fault that a person should check. The topic is emptied when it is over."""

    alarm: str
    severity: Literal["warning", "error"] = "error"
    text: str = Field(description="one sentence: the thing, what was found, what to do")
    count: int = Field(default=1, ge=1, description="how often since it was last clear")


class StatsPayload(Payload):
    """Counters since the start of the process, for dashboards."""

    uptime_s: float = Field(ge=0)
    frames: int = Field(ge=0, description="delivered by the sensor")
    frames_corrupt: int = Field(ge=0, description="broken: not delivered, or delivered and not decodable")
    frames_stale: int = Field(default=0, ge=0, description="came twice: the camera repeats itself")
    frames_dropped: int = Field(
        default=0, ge=0, description="delivered, and dropped: this machine was too slow"
    )
    frames_late: int = Field(default=0, ge=0, description="processed too late to be judged")
    delivered_fps: float = Field(ge=0)
    presses: int = Field(ge=0)
    presses_interrupted: int = Field(
        default=0,
        ge=0,
        description="frames were dropped while the gel was pressed: their presses may be missed",
    )
    verdicts: dict[str, int] = Field(default_factory=dict, description="verdict to number; `error` for none")
    reconnects: int = Field(default=0, ge=0, description="of the sensor")
    latency_ms_p50: float | None = Field(default=None, description="frame to verdict, of scored presses only")
    latency_ms_max: float | None = Field(default=None, description="likewise")
    outbox_rows: int = Field(default=0, ge=0)
    outbox_bytes: int = Field(default=0, ge=0)
    outbox_refused: int = Field(default=0, ge=0, description="rows that a receiver refuses; they are kept")
    dropped: dict[str, int] = Field(default_factory=dict, description="heatmap, pass, fail: dropped so far")
    disk_free_bytes: int | None = Field(default=None, ge=0, description="room on the disk of the database")
    gel_presses: int | None = Field(default=None, ge=0, description="of the mounted gel")
    gel_limit_presses: int | None = Field(default=None, ge=1, description="presses allowed on it")
    alarms: tuple[str, ...] = Field(default=(), description="the raised alarms, as in `alarm/<alarm>`")
    receivers: dict[str, str] = Field(
        default_factory=dict, description="receiver to `up` or why it is not; with the MQTT level in use"
    )


def state_message(payload: StatePayload) -> Message:
    return Message("state", payload.encode(), qos=1, retain=True)


def availability_message(*, is_online: bool) -> Message:
    """`online` or `offline` as plain text, for dashboards that read no JSON."""
    payload = b"online" if is_online else b"offline"
    return Message("availability", payload, qos=1, retain=True, content_type="text/plain")


def info_message(payload: InfoPayload) -> Message:
    return Message("info", payload.encode(), qos=1, retain=True)


def gel_message(payload: GelPayload) -> Message:
    return Message("gel", payload.encode(), qos=1, retain=True)


def heatmap_message(press_id: str, png: bytes) -> Message:
    """The picture of one press. The press id is in the topic, which both protocol levels can carry."""
    return Message(f"heatmap/{press_id}", png, qos=1, content_type="image/png")


def overview_message(press_id: str, jpeg: bytes) -> Message:
    """The still of the part before one press."""
    return Message(f"overview/{press_id}", jpeg, qos=1, content_type="image/jpeg")


def press_messages(
    result: ResultPayload,
    gel: GelRecord,
    heatmap_png: bytes | None = None,
    overview_jpeg: bytes | None = None,
) -> Sequence[Message]:
    """All messages of one press, in order: result, its pictures, then the retained picture, the retained result on its
    two topics, and `gel`.

    The retained picture is always that of the retained result: a press without one empties the topic.
    """
    encoded = result.encode()
    heatmap = [] if heatmap_png is None else [heatmap_message(result.press_id, heatmap_png)]
    overview = [] if overview_jpeg is None else [overview_message(result.press_id, overview_jpeg)]
    return [
        Message("result", encoded, qos=1),
        *heatmap,
        *overview,
        Message("last/heatmap", heatmap_png or b"", qos=1, retain=True, content_type="image/png"),
        Message("last", encoded, qos=1, retain=True),
        Message("last/press", encoded, qos=1, retain=True),
        gel_message(GelPayload.of(gel, result.time_ns)),
    ]


def alarm_message(payload: AlarmPayload) -> Message:
    """A raised alarm, retained until it is cleared. Errors: ValueError for an id that is not in ALARMS."""
    return Message(f"alarm/{_known_alarm(payload.alarm)}", payload.encode(), qos=1, retain=True)


def alarm_cleared(alarm: str) -> Message:
    """Removes the retained alarm from the broker. Errors: ValueError for an id that is not in ALARMS."""
    return Message(f"alarm/{_known_alarm(alarm)}", b"", qos=1, retain=True)


def stats_message(payload: StatsPayload) -> Message:
    return Message("stats", payload.encode(), qos=0)


def as_replayed(message: Message) -> Message:
    """The same message marked as sent late, where its payload has the mark; pictures stay as they are."""
    if message.content_type != "application/json" or not message.payload:
        return message
    content = json.loads(message.payload)
    if not isinstance(content, dict) or "is_replayed" not in content:
        return message
    content["is_replayed"] = True
    return replace(message, payload=json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode())


def _known_alarm(alarm: str) -> str:
    if alarm not in ALARMS:
        raise ValueError(f"alarm {alarm!r} is not known; known: {', '.join(ALARMS)}")
    return alarm
