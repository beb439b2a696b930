"""The current state, info, alarms and stats. The latest message per topic, sent again on every connection.

These bypass the outbox: an old state is useless, and a late one would be wrong.
"""

import threading
from collections.abc import Sequence

from edge.core.ports import Message
from edge.messaging.alarm_payload import ALARMS, alarm_cleared

__all__ = ["RetainedState"]


class RetainedState:
    """The latest message per topic. Any thread may use it.

    At first every known alarm is cleared, so that an alarm retained from a killed process does not stay.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[int, Message]] = {}
        self._version = 0
        self._rows: dict[str, int] = {}
        for alarm in ALARMS:
            self.announce(alarm_cleared(alarm))

    def announce(self, message: Message) -> bool:
        """Set the message of its topic; returns whether it is a change."""
        with self._lock:
            known = self._latest.get(message.topic)
            if known is not None and known[1] == message:
                return False
            self._version += 1
            self._latest[message.topic] = (self._version, message)
            return True

    def remember(self, message: Message, row_id: int) -> None:
        """A retained message from the outbox was delivered: from now on it is sent again on every connection.

        This corrects a broker that restarts without its retained messages, or with an older one. Sinks are at
        different rows; an older row never replaces a newer one.
        """
        with self._lock:
            if row_id > self._rows.get(message.topic, 0):
                self._rows[message.topic] = row_id
                version = self._latest.get(message.topic, (0, message))[0]
                self._latest[message.topic] = (version, message)

    def all(self) -> Sequence[Message]:
        """The first messages of a new connection: the retained ones, oldest change first."""
        return [message for _, message in self.since(-1) if message.retain]

    def since(self, version: int) -> list[tuple[int, Message]]:
        """The changes after that version, oldest first, each with its own version."""
        with self._lock:
            return sorted(
                (entry for entry in self._latest.values() if entry[0] > version), key=lambda entry: entry[0]
            )
