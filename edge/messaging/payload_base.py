"""What every payload has: its version, and its time in three forms.

`time` is for people (ISO 8601, UTC), `time_ns` for programs with 64-bit integers and `time_ms` for the others
(JavaScript rounds integers above 2^53).
"""

import datetime
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

__all__ = ["Payload", "iso_time"]


def iso_time(time_ns: int) -> str:
    """Wall-clock nanoseconds as ISO 8601 in UTC with microseconds, such as `2026-01-31T12:00:00.000250Z`."""
    seconds, rest = divmod(time_ns, 1_000_000_000)
    moment = datetime.datetime.fromtimestamp(seconds, datetime.UTC)
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
