"""Requests that arrive over MQTT: one table of verbs, read, dispatched and answered with the request's transaction id.

Every fault becomes a response; no request can stop the gateway.
"""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Generic, TypeVar

from pydantic import ValidationError

from edge.core.errors import GelgateError
from edge.core.ports import Clock
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.station_loop import StationLoop
from edge.messaging.command_payloads import (
    CommandArguments,
    CommandRequest,
    CommandResponse,
    NoArguments,
    ReplaceGelArguments,
)

__all__ = ["COMMANDS", "Command", "Commands", "Handler", "station_handlers"]

log = logging.getLogger(__name__)

A = TypeVar("A", bound=CommandArguments)

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""Arguments of the request -> data of the response, plain JSON. Errors: GelgateError, TypeError, ValueError."""


@dataclass(frozen=True)
class Command(Generic[A]):
    """One verb: its arguments' model, the loop's action, and its text in the manual.

    do: returns the data of the response, plain JSON. Errors of `do`: GelgateError, ValueError.
    """

    verb: str
    arguments: type[A]
    do: Callable[[StationLoop, A], Mapping[str, Any]]
    help: str


def _trigger(loop: StationLoop, arguments: NoArguments) -> Mapping[str, Any]:
    refusal = loop.session.trigger()
    if refusal is not None:
        raise ValueError(refusal)
    return {"state": loop.session.contact_state}


def _relearn(loop: StationLoop, arguments: NoArguments) -> Mapping[str, Any]:
    loop.session.relearn()
    return {"state": loop.session.contact_state}


def _replace_gel(loop: StationLoop, arguments: ReplaceGelArguments) -> Mapping[str, Any]:
    loop.replace_gel(arguments.gel_id, arguments.limit_presses, arguments.note)
    gel = loop.session.gel
    return {"gel_id": gel.gel_id, "presses": gel.presses, "limit_presses": gel.limit_presses}


COMMANDS: Final[tuple[Command[Any], ...]] = (
    Command(
        "trigger",
        NoArguments,
        _trigger,
        'score the press that is held now; the way to inspect with `trigger = "command"`',
    ),
    Command(
        "relearn", NoArguments, _relearn, "learn the picture of the free gel again; nothing may touch it"
    ),
    Command(
        "replace_gel",
        ReplaceGelArguments,
        _replace_gel,
        "record that a new gel is mounted, count from 0 and learn its picture",
    ),
)
"""All commands of a station; docs/mqtt.md prints this table."""


def station_handlers(calls: LoopCalls[StationLoop]) -> dict[str, Handler]:
    """Verb to handler. Arguments are read on the caller's thread; the station's loop does the rest."""
    return {command.verb: partial(_ask, calls, command) for command in COMMANDS}


def _ask(
    calls: LoopCalls[StationLoop], command: Command[Any], arguments: Mapping[str, Any]
) -> Mapping[str, Any]:
    wish = command.arguments.of(arguments)
    return calls.ask(lambda loop: command.do(loop, wish))


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
                verb, request.transaction, error="it failed with an internal error; see the gateway's log"
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
