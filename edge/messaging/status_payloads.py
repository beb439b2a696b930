"""The status of a station: state, installed software, counters, wear of the gel; payloads and messages."""

from typing import ClassVar, Literal, Self

from pydantic import BaseModel, Field

from edge.core.contact_state import Advice, ContactState
from edge.core.gel_life import GelState
from edge.core.ports import Message
from edge.messaging.payload_base import Payload, PressId
from edge.store.gel_ledger import GelRecord

__all__ = [
    "ChartPart",
    "ContactPayload",
    "DriftPayload",
    "GelPayload",
    "InfoPayload",
    "Question",
    "QuestionsPayload",
    "StatePayload",
    "StatsPayload",
    "availability_message",
]


class StatePayload(Payload):
    """Whether the station inspects. The broker itself publishes `lost` (the last will) when the gateway vanishes."""

    topic: ClassVar = "state"
    state: Literal["starting", "ready", "halted", "stopped", "lost"] = Field(
        description="starting: not yet inspecting; ready: inspecting; halted: running but unable to inspect, see "
        "`reason`; stopped: ended on purpose; lost: ended without a message (`time` is then that of its start)"
    )
    reason: str | None = Field(default=None, description="one sentence, for people")
    unproven: str | None = Field(
        default=None,
        description="why the bundle in use is not yet proven on the mounted gel, one sentence; null where it is. It "
        "changes no result, unless `gel.unproven` is `refuse`",
    )


class InfoPayload(Payload):
    """The installed software, bundle and sensor."""

    topic: ClassVar = "info"
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
    regions: str | None = Field(
        default=None,
        description="what a person has drawn on the part, and what of it is ignored; null for nothing",
    )
    region_names: tuple[str, ...] = Field(default=(), description="of the drawn regions")
    field_mm: tuple[float, float] | None = Field(
        default=None,
        description="width and height of the inspected region; null where `cmd/set_regions` is not served",
    )
    warnings: tuple[str, ...] = Field(
        default=(),
        description="the warnings of `fit`, such as an outlier among the presses; first those that begin with "
        "`not proven`: what the bundle's own evidence does not show",
    )


class StatsPayload(Payload):
    """Counters since the start of the process, for dashboards."""

    topic: ClassVar = "stats"
    qos: ClassVar = 0
    is_retained: ClassVar = False
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
    pieces: dict[str, int] = Field(
        default_factory=dict, description="verdict to number of the pieces of several places that are over"
    )
    reconnects: int = Field(default=0, ge=0, description="of the sensor")
    latency_ms_p50: float | None = Field(default=None, description="rest to verdict, of scored presses only")
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
    ledger_head: str | None = Field(
        default=None,
        description="the newest link of the ledger: `gelgate db check` compares it with the ledger",
    )


def availability_message(*, is_online: bool) -> Message:
    """`online` or `offline` as plain text, for dashboards that read no JSON."""
    payload = b"online" if is_online else b"offline"
    return Message("availability", payload, qos=1, retain=True, content_type="text/plain")


class GelPayload(Payload):
    """The wear of the mounted gel."""

    topic: ClassVar = "gel"
    is_replayed: bool = False
    sensor_serial: str
    gel_id: str
    presses: int = Field(ge=0)
    limit_presses: int = Field(ge=1)
    state: GelState = Field(description="good, due (order one), replace (at the limit, or optically worn)")
    wear_index: float | None = Field(default=None, description="optical wear: 0 as new, 1 to be replaced")
    first_use_ns: int | None = None
    last_use_ns: int | None = None
    gel_serial: str | None = Field(
        default=None, description="the gel's own, from its package; null where nobody wrote it down"
    )
    gel_type: str | None = Field(default=None, description="likewise, such as `plain` or `markers`")
    use_by: str | None = Field(
        default=None, description="likewise: its last day of use, YYYY-MM-DD; `alarm/gel_expired` after it"
    )

    @classmethod
    def of(cls, gel: GelRecord, time_ns: int) -> Self:
        counted = ("gel_id", "presses", "limit_presses", "state", "wear_index", "first_use_ns", "last_use_ns")
        fields = {name: getattr(gel, name) for name in (*counted, "gel_serial", "gel_type", "use_by")}
        return cls(time_ns=time_ns, sensor_serial=gel.serial, **fields)


class Question(BaseModel, strict=True, frozen=True, extra="forbid", allow_inf_nan=False):
    """One press that a person is asked about."""

    press_id: PressId
    time_ns: int = Field(ge=0)
    time_ms: int = Field(ge=0)
    verdict: str
    score_ratio: float | None = Field(
        description="score divided by threshold; null for colours of another gel, which have no score"
    )
    part: str
    position: str | None = None


class QuestionsPayload(Payload):
    """The presses that would teach most if a person said what they were; `cmd/confirm_press` answers."""

    topic: ClassVar = "questions"
    per_day: int = Field(ge=0, description="at most this number is asked on one day; 0: nobody is asked")
    answered_today: int = Field(default=0, ge=0)
    presses: tuple[Question, ...] = Field(
        default=(),
        description="those asked about once more, then oldest first: those closest to the threshold, and of five one "
        "pass and one other drawn by their times; on a gel on which the bundle is not proven, presses of it drawn by "
        "their times",
    )


class ChartPart(BaseModel, strict=True, frozen=True, extra="forbid", allow_inf_nan=False):
    """The control chart of one measure of passing presses; rises and falls are sums of standard deviations."""

    measure: str
    title: str
    unit: str
    count: int = Field(ge=0, description="passing presses; a shift can be said from `learnt` on")
    newest: float = Field(description="the mean of the newest presses, about twenty")
    mean: float = Field(description="of all")
    above: tuple[float, ...] = Field(description="how far newest presses lie above, oldest first")
    below: tuple[float, ...]
    shift: int = Field(ge=-1, le=1, description="1 higher, -1 lower than before, 0 for no shift")
    what_to_do: str


class ContactPayload(Payload):
    """What the contact is now: at every change, five times a second while something touches, else every two seconds.

    A newer one replaces an older one that waits. What is older than a second while something touches is over.
    """

    topic: ClassVar = "contact"
    qos: ClassVar = 0
    state: ContactState = Field(description="see contact.md; unknown: nothing may be taken from it")
    depth_share: float | None = Field(
        default=None,
        ge=0,
        description="depth by the strength of the imprint, 1 for the middle press at fit; null where that is not known "
        "or nothing touches. It is no force",
    )
    frame: int | None = Field(default=None, ge=0, description="number of the camera frame that shows it")
    press_id: PressId | None = Field(
        default=None, description="of the press that has its verdict and is still held"
    )
    guidance: Advice | None = Field(
        default=None,
        description="what a hand should do; shift: the contact, tilt: press that side more; null where nothing is sure",
    )
    direction_deg: float | None = Field(
        default=None, ge=0, le=360, description="of shift and tilt: 0 to the right in the picture, 90 down"
    )


class DriftPayload(Payload):
    """The control charts of the passing presses of the bundle in use, on the mounted gel."""

    topic: ClassVar = "drift"
    part: str
    position: str | None = None
    gel_id: str
    learnt: int = Field(description="presses before a shift can be said")
    limit: float = Field(description="of `above` and `below`; beyond it a shift is said")
    charts: tuple[ChartPart, ...] = ()
