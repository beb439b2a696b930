"""Keeps messages in memory: for tests, and for programs that embed the gateway.

What it does not do: it loses everything at a restart, has no limit, connects to nothing, and never refuses.
"""

import threading

from pydantic import BaseModel

from edge.core.plugins import SinkPlugin
from edge.core.ports import Message
from edge.core.sink_context import Station

__all__ = ["Memory", "MemoryOptions", "MemorySink", "plugin"]


class MemoryOptions(BaseModel, extra="forbid", frozen=True):
    """It has no options."""


class MemorySink:
    """Every message sent, in order, topics relative to the station's root. Any thread may read `messages`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._messages: list[Message] = []

    @property
    def messages(self) -> list[Message]:
        with self._lock:
            return list(self._messages)

    def send(self, message: Message) -> None:
        with self._lock:
            self._messages.append(message)

    def close(self) -> None:
        """Nothing to close; the messages stay readable."""


class Memory(SinkPlugin[MemoryOptions]):
    """The plugin."""

    Options = MemoryOptions

    def open(self, options: MemoryOptions, station: Station) -> MemorySink:
        """A sink that holds the station's birth messages."""
        sink = MemorySink()
        for message in station.birth():
            sink.send(message)
        return sink


plugin = Memory()
