"""What every published JSON payload has: its version, its time, and whether it was sent late.

Each payload is one pydantic model; the modules are by subject: `result_payload`, `gel_payload`, `alarm_payload`,
`status_payloads`, `command_payloads`. They also make the messages, with topic, delivery and retention.
`time` is for people (ISO 8601, UTC), `time_ns` for programs with 64-bit integers and `time_ms` for the others
(JavaScript rounds integers above 2^53).
Units are in the names. Within version 1 fields may be added; a subscriber ignores those it does not know.
docs/mqtt.md is printed from these models.
"""

import datetime
import json
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from edge.core.ports import Message

__all__ = ["Payload", "PressId", "as_replayed", "iso_time"]

PressId = Annotated[str, StringConstraints(pattern=r"^[0-7][0-9A-HJKMNP-TV-Z]{25}$")]
"""A ULID."""


def iso_time(time_ns: int) -> str:
    """Wall-clock nanoseconds as ISO 8601 in UTC with microseconds, such as `2026-01-31T12:00:00.000250Z`.

    Errors: ValueError for a time beyond the year 9999.
    """
    seconds, rest = divmod(time_ns, 1_000_000_000)
    try:
        moment = datetime.datetime.fromtimestamp(seconds, datetime.UTC)
    except (OverflowError, OSError) as error:
        raise ValueError("the time is beyond the year 9999") from error
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"


class Payload(BaseModel):
    """The fields of every JSON payload. `time` is computed from `time_ns` and must agree with it."""

    model_config = ConfigDict(
        strict=True,
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        json_schema_serialization_defaults_required=True,
    )

    topic: ClassVar[str]
    """Below the station's root."""
    qos: ClassVar[int] = 1
    is_retained: ClassVar[bool] = True

    version: Literal[1] = 1
    time_ns: int = Field(ge=0, description="wall clock, nanoseconds since 1970 UTC")
    time_ms: int = Field(
        default=-1, ge=0, description="the same moment in milliseconds, exact in JavaScript too"
    )
    time: str = Field(default="", description="the same moment, ISO 8601 UTC, microseconds")

    @model_validator(mode="before")
    @classmethod
    def _fill_time(cls, data: Any) -> Any:
        if not (isinstance(data, dict) and isinstance(data.get("time_ns"), int)):
            return data
        time_ns = data["time_ns"]
        missing = {"time_ms": time_ns // 1_000_000} if "time_ms" not in data else {}
        return {**data, **missing, "time": data.get("time") or iso_time(time_ns)}

    @model_validator(mode="after")
    def _times_agree(self) -> Self:
        if self.time != iso_time(self.time_ns):
            raise ValueError(f"time is {self.time!r}, but time_ns says {iso_time(self.time_ns)!r}")
        if self.time_ms != self.time_ns // 1_000_000:
            raise ValueError(f"time_ms is {self.time_ms}, but time_ns says {self.time_ns // 1_000_000}")
        return self

    def encode(self) -> bytes:
        """The payload as UTF-8 JSON."""
        return self.model_dump_json().encode()

    def message(self) -> Message:
        """Return the message that publishes it."""
        return Message(self.topic, self.encode(), self.qos, self.is_retained)


def as_replayed(message: Message) -> Message:
    """Mark a message as sent late, where its payload has the mark; pictures stay as they are."""
    if message.content_type != "application/json" or not message.payload:
        return message
    content = json.loads(message.payload)
    if not isinstance(content, dict) or "is_replayed" not in content:
        return message
    content["is_replayed"] = True
    return replace(message, payload=json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode())
