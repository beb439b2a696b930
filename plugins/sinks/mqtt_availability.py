"""The topic `availability` at a broker, and the second connection that holds its last will.

MQTT gives a connection one last will, and the first connection of a station holds that of `state`. The second one
sends nothing. Where a broker does not allow it, the topic is emptied: `online` could stay for ever.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from edge.core.errors import SinkError
from edge.core.ports import Clock, Message
from edge.messaging.mqtt_broker import Broker, Level
from edge.messaging.mqtt_connection import Connection

__all__ = ["Availability"]

log = logging.getLogger(__name__)

# A second connection that ends sooner is a short one; after this number in a row it is opened again only at `retry`.
SHORT_S: Final = 5.0
SHORT_ONES: Final = 3


class Availability:
    """offline: the will, with its full topic; None where the station has none. is_wanted: by the options."""

    def __init__(
        self, broker: Broker, offline: Message | None, clock: Clock, *, is_wanted: bool = True
    ) -> None:
        self._broker = replace(broker, client_id=f"{broker.client_id}-availability")
        self._offline, self._clock = offline, clock
        self._is_wanted = is_wanted
        self._connection: Connection | None = None
        self._opened_ns: int | None = None
        self._short_ones = 0
        self.fault: str | None = None

    @property
    def is_held(self) -> bool:
        """True while the broker has the will."""
        return self._connection is not None and self._connection.is_up

    def open(self, level: Level, on_lost: Callable[[], None]) -> None:
        """Leave the will with the broker; a refusal is a fault and stops nothing. on_lost: called if it is lost."""
        self.abandon()
        self._short_ones = 0
        if self._offline is not None and self._is_wanted:
            self._open(level, on_lost)

    @property
    def is_missing(self) -> bool:
        """True where it should be held and is not."""
        return self._offline is not None and self._is_wanted and not self.is_held

    def renew(self, level: Level, on_lost: Callable[[], None]) -> None:
        """Open it again at once after a loss, but not for ever."""
        now_ns = self._clock.monotonic_ns()
        is_short = self._opened_ns is not None and now_ns - self._opened_ns < SHORT_S * 1e9
        self._short_ones = self._short_ones + 1 if is_short else 0
        if self._short_ones < SHORT_ONES:
            self._open(level, on_lost)
        else:
            self._note("the broker closes it soon after it accepts it")

    def outgoing(self, message: Message) -> Message:
        """Give what to publish for a message of the station: on this topic nothing while the will is not held."""
        if self._offline is None or message.topic != self._offline.topic or self.is_held:
            return message
        return replace(message, payload=b"")

    def close(self) -> None:
        """Disconnect: the will is not published. May be called again."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def abandon(self) -> None:
        """Leave without a DISCONNECT: the broker publishes the will. May be called again."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.abandon("the station's connection is lost")

    def _open(self, level: Level, on_lost: Callable[[], None]) -> None:
        self._opened_ns = self._clock.monotonic_ns()
        try:
            self._connection = Connection.open(
                replace(self._broker, level=level), will=self._offline, on_lost=on_lost
            )
            self.fault = None
        except SinkError as error:
            self._note(str(error))

    def _note(self, why: str) -> None:
        before = self.fault
        self.fault = (
            f"the topic availability is empty: its second connection, client id '{self._broker.client_id}', is not "
            f"kept ({why}); allow this client id, or set availability = false"
        )
        if before is None:
            log.warning("%s", self.fault)
