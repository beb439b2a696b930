"""A piece that is pressed at several places: what is still to be pressed, and its verdict."""

from typing import ClassVar, Literal, Self

from pydantic import BaseModel, Field

from edge.core.piece import End, Piece, PieceVerdict
from edge.messaging.payload_base import Payload, PressId

__all__ = ["PiecePayload", "PiecePlace", "PieceResultPayload"]


class PiecePlace(BaseModel, strict=True, frozen=True, extra="forbid", allow_inf_nan=False):
    """One place of a piece."""

    part: str
    position: str
    verdict: Literal["pass", "fail"] | None = Field(
        default=None, description="null while it is still to be pressed"
    )
    press_id: PressId | None = Field(default=None, description="of the press that decided it")

    @classmethod
    def all_of(cls, piece: Piece) -> tuple[Self, ...]:
        filled = {place.place: place for place in piece.filled}
        return tuple(
            cls(**place._asdict(), verdict=one.verdict, press_id=one.press_id)
            if (one := filled.get(place))
            else cls(**place._asdict())
            for place in piece.places
        )


class PiecePayload(Payload):
    """The piece in progress, and what is still to be pressed of it."""

    topic: ClassVar = "piece"
    piece_id: str | None = Field(default=None, description="null while none is in progress")
    order: Literal["free", "fixed"]
    places: tuple[PiecePlace, ...] = Field(description="every place of the plan")
    expected: tuple[str, ...] = Field(
        description="what may be pressed next, part/position each; with a fixed order one place"
    )
    last_id: str | None = Field(default=None, description="the piece that ended last")
    last_verdict: PieceVerdict | None = Field(default=None, description="its verdict")

    @classmethod
    def of(cls, piece: Piece, time_ns: int, *, is_begun: bool, last: tuple[str, PieceVerdict] | None) -> Self:
        """is_begun: it is in progress, else it is what the next one would be."""
        return cls(
            time_ns=time_ns,
            piece_id=piece.piece_id if is_begun else None,
            order=piece.order,
            places=PiecePlace.all_of(piece),
            expected=tuple(map(str, piece.expected)),
            last_id=None if last is None else last[0],
            last_verdict=None if last is None else last[1],
        )


class PieceResultPayload(Payload):
    """One piece, one result. `piece_id` is the key: the same result may arrive twice; only `is_replayed` may differ."""

    topic: ClassVar = "piece_result"
    is_retained: ClassVar = False
    is_replayed: bool = Field(default=False, description="sent late, from the outbox")
    piece_id: str
    verdict: PieceVerdict = Field(
        description="pass: every place has passed; fail: one has failed; incomplete: none has failed, and one is "
        "missing"
    )
    ended_by: End = Field(
        description="complete: every place came; time: it took longer than `piece.within_s`; next piece: that was begun"
    )
    began_ns: int = Field(
        ge=0, description="wall clock, nanoseconds since 1970 UTC; `time` is that of its end"
    )
    places: tuple[PiecePlace, ...]

    @classmethod
    def of(cls, piece: Piece, why: End, time_ns: int) -> Self:
        return cls(
            time_ns=time_ns,
            piece_id=piece.piece_id,
            verdict=piece.verdict,
            ended_by=why,
            began_ns=piece.began_ns,
            places=PiecePlace.all_of(piece),
        )
