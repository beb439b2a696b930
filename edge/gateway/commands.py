"""Requests that arrive over MQTT: read, dispatched to a handler, and answered with the request's transaction id.

Every fault becomes a response; nothing a subscriber sends can stop the gateway.
"""

import logging
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import ValidationError

from edge.core.errors import GelgateError
from edge.core.ports import Clock
from edge.messaging.payloads import CommandRequest, CommandResponse

__all__ = ["Commands", "Handler"]

log = logging.getLogger(__name__)

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""Arguments of the request -> data of the response, plain JSON. Errors: GelgateError, TypeError, ValueError."""


class Commands:
    """Verbs and their handlers; a `Station.on_command`. Handlers are called from the sink's thread, one at a time."""

    def __init__(self, handlers: Mapping[str, Handler], clock: Clock) -> None:
        self._handlers = dict(handlers)
        self._clock = clock

    def __call__(self, verb: str, payload: bytes) -> bytes:
        """The response to one request."""
        try:
            request = CommandRequest.model_validate_json(payload)
        except ValidationError as error:
            fault = error.errors()[0]
            where = ".".join(str(part) for part in fault["loc"]) or "the request"
            return self._answer(verb, None, error=f"{where}: {fault['msg']}; see docs/mqtt.md")
        handler = self._handlers.get(verb)
        if handler is None:
            known = ", ".join(sorted(self._handlers)) or "none"
            return self._answer(
                verb, request.transaction, error=f"no command is named '{verb}'; known: {known}"
            )
        try:
            return self._answer(verb, request.transaction, data=dict(handler(request.arguments)))
        except (GelgateError, TypeError, ValueError) as error:
            log.warning("command %s was refused: %s", verb, error)
            return self._answer(verb, request.transaction, error=str(error))
        except Exception:  # a sink's thread ends here: a request must not end it
            log.exception("command %s failed", verb)
            return self._answer(
                verb, request.transaction, error="it failed inside; the gateway's log says how"
            )

    def _answer(
        self,
        verb: str,
        transaction: str | None,
        error: str | None = None,
        data: Mapping[str, Any] | None = None,
    ) -> bytes:
        return CommandResponse(
            time_ns=self._clock.time_ns(),
            transaction=transaction,
            verb=verb,
            status="ok" if error is None else "error",
            error=error,
            data=dict(data or {}),
        ).encode()
