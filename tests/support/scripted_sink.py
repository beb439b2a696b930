"""A sink that does what the test says, and its worker."""

import json
import random

from edge.clock import ManualClock
from edge.core.backoff import Backoff
from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.ports import Message
from edge.messaging.sink_worker import RetainedState, SinkWorker
from edge.store.outbox import Outbox


class ScriptedSink:
    """Accepts messages; a test can make it unreachable, lose an acknowledgement or refuse a topic."""

    def __init__(self) -> None:
        self.taken: list[Message] = []
        self.is_away = False
        self.refuses: set[str] = set()
        self.refused: list[str] = []
        self.loses_next_acknowledgement = False
        self.loses_acknowledgements_of = ""
        """A topic."""
        self.is_closed = False

    def send(self, message: Message) -> None:
        if self.is_away:
            raise SinkUnavailable("away")
        if message.topic in self.refuses:
            self.refused.append(message.topic)
            raise SinkRejected(f"{message.topic} is not for you")
        self.taken.append(message)
        if self.loses_next_acknowledgement or message.topic == self.loses_acknowledgements_of:
            self.loses_acknowledgements_of = ""
            self.loses_next_acknowledgement = False
            raise SinkUnavailable("no acknowledgement in time")

    def close(self) -> None:
        self.is_closed = True

    def results(self) -> list[dict[str, object]]:
        return [json.loads(m.payload) for m in self.taken if m.topic == "result"]

    def topics(self) -> list[str]:
        return [m.topic for m in self.taken if not m.topic.startswith("alarm/")]


def worker(
    outbox: Outbox,
    sink: ScriptedSink,
    name: str = "mqtt",
    retained_state: RetainedState | None = None,
    clock: ManualClock | None = None,
) -> SinkWorker:
    backoff = Backoff(random.Random(1), 0.1, 5.0)
    return SinkWorker(name, sink, outbox, retained_state or RetainedState(), clock or ManualClock(), backoff)


def drain(worker: SinkWorker) -> None:
    while worker.step() == 0.0:
        pass
