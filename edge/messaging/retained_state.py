"""What is true now: state, info, alarms and stats. The latest message per topic; said again on every connection.

These bypass the outbox: an old state is worth nothing, and a late one would be a lie.
"""

import threading
from collections.abc import Sequence

from edge.core.ports import Message
from edge.messaging.payloads import ALARMS, alarm_cleared

__all__ = ["RetainedState"]


class RetainedState:
    """The latest message per topic. Any thread may use it.

    It begins with every known alarm cleared, so that an alarm retained from a process that died does not stay.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[int, Message]] = {}
        self._version = 0
        self._rows: dict[str, int] = {}
        for alarm in ALARMS:
            self.announce(alarm_cleared(alarm))

    def announce(self, message: Message) -> bool:
        """From now on this is what its topic says; gives whether that is news."""
        with self._lock:
            known = self._latest.get(message.topic)
            if known is not None and known[1] == message:
                return False
            self._version += 1
            self._latest[message.topic] = (self._version, message)
            return True

    def remember(self, message: Message, row_id: int) -> None:
        """A retained message from the outbox was delivered: from now on it is said again on every connection.

        A broker that restarts without its retained messages, or one that only knows an older one, is thus put right.
        Sinks are at different rows; an older row never takes the place of a newer one.
        """
        with self._lock:
            if row_id > self._rows.get(message.topic, 0):
                self._rows[message.topic] = row_id
                version = self._latest.get(message.topic, (0, message))[0]
                self._latest[message.topic] = (version, message)

    def all(self) -> Sequence[Message]:
        """What a new connection says first: the retained ones, oldest change first."""
        return [message for _, message in self.since(-1) if message.retain]

    def since(self, version: int) -> list[tuple[int, Message]]:
        """What changed after that version, oldest change first, each with its own version."""
        with self._lock:
            return sorted(
                (entry for entry in self._latest.values() if entry[0] > version), key=lambda entry: entry[0]
            )
