"""Requests to a station and its responses: one pydantic model per payload of `cmd/`, and the signature of a request.

Signed is one JSON text with sorted keys, no blanks and `\\u` for everything that is not ASCII, so that programs in any
language make the same bytes, by HMAC-SHA256 (RFC 2104, FIPS 180-4) with a secret that the station and the asker share:

    {"arguments":{},"by":null,"root":"<root>","time_ns":1,"transaction":"t","verb":"relearn"}

The root is that of the station's topics: a request for one station is not valid at another with the same secret.
"""

import hashlib
import hmac
import json
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    field_validator,
    model_validator,
)

from edge.core.gel_life import MOST_PRESSES, GelLabel
from edge.messaging.payload_base import Payload

__all__ = [
    "LARGEST_REQUEST_BYTES",
    "SHORTEST_SECRET",
    "WAITING_REQUESTS",
    "AcknowledgeAlarmArguments",
    "CommandArguments",
    "CommandRequest",
    "CommandResponse",
    "CommandTransaction",
    "NoArguments",
    "PlainText",
    "ReplaceGelArguments",
    "SelectPartArguments",
    "describe_fault",
    "is_signed",
    "signature_of",
    "signed_text",
]

# The largest request; those of the shipped verbs have some hundred bytes.
LARGEST_REQUEST_BYTES: Final = 16 << 10

# Requests that may wait while one is answered; a person or a line controller sends fewer at once.
WAITING_REQUESTS: Final = 16

PlainText = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]*$")]
"""Without control characters, which a terminal would obey."""


class CommandTransaction(BaseModel):
    """The part of a request by which its response is told from others."""

    model_config = ConfigDict(strict=True, frozen=True)

    transaction: PlainText = Field(
        min_length=1,
        max_length=128,
        description="chosen by the requester, returned in the response; the same one within a minute is the same "
        "request, and is not done twice",
    )


class CommandRequest(CommandTransaction):
    """What arrives on `cmd/<verb>`. Retained requests are ignored: they would run again on every connection."""

    model_config = ConfigDict(extra="forbid")

    arguments: dict[str, Any] = Field(default_factory=dict, description="of the verb; may be left out")
    by: PlainText | None = Field(
        default=None, max_length=64, description="who asks, for the table of acts; claimed, unless signed"
    )
    time_ns: int | None = Field(default=None, ge=0, description="wall clock of a signed request")
    signature: str | None = Field(
        default=None, pattern=r"^[0-9a-f]{64}$", description="HMAC-SHA256 of a signed request, hexadecimal"
    )

    @field_validator("arguments")
    @classmethod
    def _can_be_kept(cls, arguments: dict[str, Any]) -> dict[str, Any]:
        """Refuse NaN, infinity and integers without end, which are no JSON: the table of acts keeps the arguments."""
        json.dumps(arguments, allow_nan=False)
        return arguments


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
            faults = "; ".join(describe_fault(dict(fault), "arguments") for fault in error.errors())
            raise ValueError(f"{faults} (known arguments: {known})") from error


def describe_fault(fault: Mapping[str, Any], whole: str) -> str:
    """Say what pydantic found wrong. whole: the name of what has no place of its own."""
    place = ".".join(map(str, fault["loc"])) or whole
    if fault["type"] == "string_pattern_mismatch":
        return f"{place}: it has another form than expected"
    return f"{place}: {fault['msg'].removeprefix('Value error, ')}"


class NoArguments(CommandArguments):
    """Of `cmd/trigger`, `cmd/relearn`, `cmd/reload`, `cmd/prove_gel` and `cmd/self_test`."""


class ReplaceGelArguments(CommandArguments):
    """Of `cmd/replace_gel`."""

    gel_id: PlainText | None = Field(default=None, min_length=1, max_length=64)
    limit_presses: int | None = Field(default=None, ge=1, le=MOST_PRESSES)
    note: PlainText = Field(default="", max_length=1000)
    gel_serial: str | None = Field(
        default=None, description="the gel's own, from its package; a gel that was mounted before counts on"
    )
    gel_type: str | None = Field(default=None, description="such as `plain` or `markers`")
    use_by: str | None = Field(default=None, description="its last day of use, YYYY-MM-DD")

    @property
    def label(self) -> GelLabel:
        """What the package says. Errors: ValueError."""
        return GelLabel.of(self.gel_serial, self.gel_type, self.use_by)


class SelectPartArguments(CommandArguments):
    """Of `cmd/select_part`: either `part`, with its `position` where it has several, or `name`."""

    part: PlainText | None = Field(default=None, min_length=1, max_length=64)
    position: PlainText | None = Field(default=None, min_length=1, max_length=64)
    name: PlainText | None = Field(default=None, min_length=1, max_length=256)

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.part is None) == (self.name is None) or (
            self.name is not None and self.position is not None
        ):
            raise ValueError("expected either part, with or without position, or name")
        return self


class AcknowledgeAlarmArguments(CommandArguments):
    """Of `cmd/acknowledge_alarm`."""

    alarm: PlainText = Field(min_length=1, max_length=64)


class CommandResponse(Payload):
    """What leaves on `cmd/<verb>/response`, or on the request's MQTT 5 response topic."""

    transaction: str | None = Field(description="that of the request; null if it could not be read")
    verb: str
    status: Literal["ok", "error"]
    error: str | None = None
    data: dict[str, Any] = Field(default_factory=dict)
    is_repeated: bool = Field(
        default=False,
        description="the request was done before; this is its outcome, and nothing was done now",
    )

    @classmethod
    def of(
        cls, time_ns: int, verb: str, error: str | None, transaction: str | None = None, **more: Any
    ) -> Self:
        """Answer that it was done, or why not. more: data and is_repeated."""
        status: Literal["ok", "error"] = "ok" if error is None else "error"
        return cls(
            time_ns=time_ns, transaction=transaction, verb=verb[:64], status=status, error=error, **more
        )


# A secret of fewer bytes could be guessed from one request.
SHORTEST_SECRET: Final = 16


def signed_text(
    root: str, verb: str, transaction: str, time_ns: int, by: str | None, arguments: Mapping[str, Any]
) -> bytes:
    """The bytes that are signed."""
    content = {
        "arguments": dict(arguments),
        "by": by,
        "root": root,
        "time_ns": time_ns,
        "transaction": transaction,
        "verb": verb,
    }
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def signature_of(secret: bytes, text: bytes) -> str:
    """64 hexadecimal digits."""
    return hmac.new(secret, text, hashlib.sha256).hexdigest()


def is_signed(secret: bytes, text: bytes, signature: str) -> bool:
    """Compared in constant time."""
    return hmac.compare_digest(signature_of(secret, text), signature)
