"""Requests to a station and its responses: one pydantic model per payload of `cmd/`."""

from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edge.core.gel import MOST_PRESSES
from edge.messaging.payloads import Payload

__all__ = ["CommandArguments", "CommandRequest", "CommandResponse", "NoArguments", "ReplaceGelArguments"]


class CommandRequest(BaseModel):
    """What arrives on `cmd/<verb>`. Retained requests are ignored: they would run again on every connection."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    transaction: str = Field(
        min_length=1, max_length=128, description="chosen by the requester, returned in the response"
    )
    arguments: dict[str, Any] = Field(default_factory=dict, description="of the verb; may be left out")


class CommandArguments(BaseModel):
    """Arguments of a verb; each verb has its own."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Self:
        """Read the arguments of a request. Errors: ValueError, one sentence."""
        try:
            return cls.model_validate(dict(arguments))
        except ValidationError as error:
            known = ", ".join(cls.model_fields) or "none"
            faults = "; ".join(f"{'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
            raise ValueError(f"{faults} (known arguments: {known})") from error


class NoArguments(CommandArguments):
    """Of `cmd/trigger` and `cmd/relearn`."""


class ReplaceGelArguments(CommandArguments):
    """Of `cmd/replace_gel`."""

    gel_id: str | None = Field(default=None, min_length=1, max_length=64)
    limit_presses: int | None = Field(default=None, ge=1, le=MOST_PRESSES)
    note: str = Field(default="", max_length=1000)


class CommandResponse(Payload):
    """What leaves on `cmd/<verb>/response`, or on the request's MQTT 5 response topic."""

    transaction: str | None = Field(description="that of the request; null if it could not be read")
    verb: str
    status: Literal["ok", "error"]
    error: str | None = None
    data: dict[str, Any] = Field(default_factory=dict)
