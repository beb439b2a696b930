"""Connections that end while a message waits for its acknowledgement: is it the message, or the broker?

A level 3.1.1 broker cannot report "too large": it closes the connection. Three closings in a row, each while the same
message waited and after the broker had acknowledged others, are taken as that report. A silent broker reports nothing,
however often: the message waits.
"""

from collections.abc import Sequence
from typing import Final

from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.messaging.mqtt_connection import Connection

__all__ = ["Strikes"]

STRIKES: Final = 3


class Strikes:
    """has_proof: whether the connection in use has acknowledged other messages, those of its birth."""

    def __init__(self) -> None:
        self.has_proof = False
        self._closed: tuple[Message | None, int] = (None, 0)
        self._silent: tuple[Message | None, int] = (None, 0)

    @property
    def is_suspecting(self) -> bool:
        """True while connections end and one message waits."""
        return self._closed[1] > 0 or self._silent[1] > 0

    @property
    def faults(self) -> Sequence[str]:
        message, times = self._silent
        if message is None or times < STRIKES:
            return []
        return [
            f"the broker takes other messages and was silent {times} times on the one on {message.topic}, "
            f"{len(message.payload)} bytes; it is sent until it is acknowledged"
        ]

    def lost(self, message: Message, connection: Connection, error: SinkUnavailable) -> None:
        """The connection ended while this message waited. Errors: SinkRejected when the message is the reason."""
        if connection.was_given_up:
            self._silent = _one_more(self._silent, message)
            return
        if connection.was_taken_over or not self.has_proof:
            return
        self._closed = _one_more(self._closed, message)
        if self._closed[1] >= STRIKES:
            self._closed = (None, 0)
            raise SinkRejected(
                f"broker {connection.broker} closed the connection {STRIKES} times on the same message on "
                f"{message.topic}, {len(message.payload)} bytes, and took others; it may be larger than the broker "
                "allows"
            ) from error

    def delivered(self, message: Message) -> None:
        """This message was acknowledged: that on its topic, or one that has taken its place."""
        if self._closed[0] is not None and self._closed[0].topic == message.topic:
            self._closed = (None, 0)
        if self._silent[0] is not None and self._silent[0].topic == message.topic:
            self._silent = (None, 0)


def _one_more(before: tuple[Message | None, int], message: Message) -> tuple[Message, int]:
    return message, before[1] + 1 if before[0] == message else 1
