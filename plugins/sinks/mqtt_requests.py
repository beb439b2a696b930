"""Requests that arrive over MQTT, bounded in size and number, and the topic of each answer.

Every request is answered, those that are refused here too. An answer leaves on a topic below that of its request: with
the station's rights anything else could be overwritten, its own state included.
"""

import logging
import queue
from typing import Final

from edge.clock import SystemClock
from edge.core.errors import SinkError
from edge.core.ports import Message
from edge.core.rate import Rate
from edge.core.sink_context import Station
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES, WAITING_REQUESTS
from edge.messaging.mqtt_broker import Received
from edge.messaging.mqtt_connection import Connection

__all__ = ["Requests"]

log = logging.getLogger(__name__)

# A flood has no line for each request.
LINES_PER_MINUTE: Final = 10


class Requests:
    """The requests of one station. `receive` is called by the connection's thread, `next` by the answering one."""

    def __init__(self, station: Station) -> None:
        self._station = station
        self._waiting: queue.Queue[Received | None] = queue.Queue(WAITING_REQUESTS)
        self._lines = Rate(LINES_PER_MINUTE, SystemClock())

    def receive(self, request: Received, connection: Connection | None) -> None:
        """Keep the request for `next`, or refuse it at once. Never waits."""
        if request.retain:
            log.warning(
                "a retained request on %s is ignored: it would run at every connection", request.topic
            )
            return
        why = self._refusal(request)
        if why is None:
            try:
                self._waiting.put_nowait(request)
            except queue.Full:
                why = f"{WAITING_REQUESTS} requests are waiting; ask again later"
        if why is not None:
            if self._lines.take():
                log.warning("a request on %s is refused: %s", request.topic, why)
            if self._station.on_refused is not None and connection is not None:
                payload = self._station.on_refused(
                    _verb(request), request.payload[:LARGEST_REQUEST_BYTES], why
                )
                connection.publish_soon(_response(request, payload))

    def next(self) -> Received | None:
        """The oldest request; waits for one. None after `close`."""
        return self._waiting.get()

    def close(self) -> None:
        """Forget what waits, and let `next` return None."""
        while not self._waiting.empty():
            self._waiting.get_nowait()
        self._waiting.put(None)

    def answer(self, request: Received, connection: Connection | None) -> None:
        """Do what is asked, and publish the response. Never raises a SinkError."""
        if self._station.on_command is None:
            return
        response = _response(request, self._station.on_command(_verb(request), request.payload))
        try:
            if connection is not None:
                connection.publish(response)
        except SinkError as error:
            log.warning("a response is not delivered: %s", error)

    def _refusal(self, request: Received) -> str | None:
        if len(request.payload) > LARGEST_REQUEST_BYTES:
            return f"it has {len(request.payload)} bytes, a request has at most {LARGEST_REQUEST_BYTES}"
        if not _may_answer_on(request):
            return f"its response topic is not {request.topic}/response or a topic below; nothing was done"
        return None


def _verb(request: Received) -> str:
    return request.topic.rpartition("/")[2]


def _may_answer_on(request: Received) -> bool:
    own, wanted = f"{request.topic}/response", request.response_topic
    if wanted is None:
        return True
    # A filter is no topic: the library refuses it, and in its own thread that would be the end of the connection.
    return (wanted == own or wanted.startswith(f"{own}/")) and not {"+", "#"} & set(wanted)


def _response(request: Received, payload: bytes) -> Message:
    topic = request.response_topic if _may_answer_on(request) else None
    return Message(
        topic or f"{request.topic}/response",
        payload,
        content_type="application/json",
        correlation=request.correlation,
    )
