"""The wear of the mounted gel: payload and message."""

from typing import Self

from pydantic import Field

from edge.core.gel import GelState
from edge.core.ports import Message
from edge.messaging.payload_base import Payload
from edge.store.gel_ledger import GelRecord

__all__ = ["GelPayload", "gel_message"]


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


def gel_message(payload: GelPayload) -> Message:
    return Message("gel", payload.encode(), qos=1, retain=True)
