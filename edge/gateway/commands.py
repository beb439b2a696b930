"""Requests that arrive over MQTT: one table of verbs; read, allowed or refused, recorded, done once, and answered.

Every fault becomes a response; no request can stop the gateway. `command_policy` says who may ask for what. A request
is recorded before it is done, and completed with its outcome: a repetition gets that outcome, and is not done again.
"""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Generic, TypeVar

from pydantic import ValidationError

from edge.core.errors import GelgateError, StoreError
from edge.core.ports import Clock
from edge.gateway.command_policy import CommandPolicy, Rate
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.station_loop import StationLoop
from edge.messaging.command_payloads import (
    CommandArguments,
    CommandRequest,
    CommandResponse,
    NoArguments,
    ReplaceGelArguments,
    SelectPartArguments,
)
from edge.store.acts import Act
from edge.store.press_store import Store

__all__ = ["COMMANDS", "Change", "Command", "Commands", "Handler", "station_handlers"]

log = logging.getLogger(__name__)

A = TypeVar("A", bound=CommandArguments)

# The same transaction id within this time is the same request: MQTT delivers at least once.
REPEATED_WITHIN_S: Final = 60.0


@dataclass(frozen=True)
class Change:
    """What a request did. data: of the response. before, after: the gel and the state of contact, for the table of
    acts. All are plain JSON."""

    data: Mapping[str, Any]
    before: Mapping[str, Any] | None = None
    after: Mapping[str, Any] | None = None


Handler = Callable[[Mapping[str, Any]], Change]
"""Arguments of the request -> what was done. Errors: GelgateError, TypeError, ValueError."""


@dataclass(frozen=True)
class Command(Generic[A]):
    """One verb: its arguments' model, the loop's action, and its text in the manual.

    changes: what it changes for good, for the manual; empty for nothing. do: returns the data of the response, plain
    JSON. Errors of `do`: GelgateError, ValueError.
    """

    verb: str
    arguments: type[A]
    do: Callable[[StationLoop, A], Mapping[str, Any]]
    help: str
    changes: str = ""


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


def _select_part(loop: StationLoop, arguments: SelectPartArguments) -> Mapping[str, Any]:
    if arguments.name is not None:
        loop.select_named(arguments.name)
    else:
        loop.select_part(arguments.part or "", arguments.position)
    return {**_selected(loop), "is_waiting": loop.selection.is_waiting}


def _reload(loop: StationLoop, arguments: NoArguments) -> Mapping[str, Any]:
    loop.selection.reload()
    return {"is_waiting": True}


COMMANDS: Final[tuple[Command[Any], ...]] = (
    Command(
        "trigger",
        NoArguments,
        _trigger,
        'score the press that is held now; the way to inspect with `trigger = "command"`',
    ),
    Command(
        "relearn",
        NoArguments,
        _relearn,
        "learn the picture of the free gel again; nothing may touch it",
        "nothing is inspected until the gel is seen free",
    ),
    Command(
        "replace_gel",
        ReplaceGelArguments,
        _replace_gel,
        "record that a new gel is mounted, count from 0 and learn its picture",
        "the record of wear",
    ),
    Command(
        "select_part",
        SelectPartArguments,
        _select_part,
        "inspect another position or part from the next press on; during a press it waits for its end (`is_waiting`)",
        "the bundle that inspects",
    ),
    Command(
        "reload",
        NoArguments,
        _reload,
        "open the configured bundles again while presses are judged as before; `info` and the alarm `bundle` have the "
        "outcome",
        "the bundles",
    ),
)
"""All commands of a station; docs/mqtt.md prints this table."""


def station_handlers(calls: LoopCalls[StationLoop]) -> dict[str, Handler]:
    """Verb to handler. Arguments are read on the caller's thread; the station's loop does the rest."""
    return {command.verb: partial(_ask, calls, command) for command in COMMANDS}


def _ask(calls: LoopCalls[StationLoop], command: Command[Any], arguments: Mapping[str, Any]) -> Change:
    wish = command.arguments.of(arguments)

    def do(loop: StationLoop) -> Change:
        before = _facts(loop)
        data = command.do(loop, wish)
        return Change(data, before, _facts(loop))

    return calls.ask(do)


def _facts(loop: StationLoop) -> Mapping[str, Any]:
    """As far as it is known: before the first frame the gel is not."""
    if not loop.has_session:
        return _selected(loop)
    gel = loop.session.gel
    return {
        "gel_id": gel.gel_id,
        "presses": gel.presses,
        "limit_presses": gel.limit_presses,
        "state": loop.session.contact_state,
        **_selected(loop),
    }


def _selected(loop: StationLoop) -> Mapping[str, Any]:
    part, bundle = loop.selection.part, loop.selection.inspector.bundle
    return {"part": part.part, "position": part.position, "bundle_id": bundle.digest}


class Commands:
    """Verbs and their handlers; a `Station.on_command`. Handlers are called from the sink's thread, one at a time.

    store: keeps the acts. per_minute: requests that are served; more are refused, and not recorded.
    """

    def __init__(
        self,
        handlers: Mapping[str, Handler],
        policy: CommandPolicy,
        store: Store,
        clock: Clock,
        per_minute: int = 60,
    ) -> None:
        self._handlers = dict(handlers)
        self._policy = policy
        self._store = store
        self._clock = clock
        self._per_minute = per_minute
        self._rate = Rate(per_minute, clock)

    def __call__(self, verb: str, payload: bytes) -> bytes:
        """The response to one request."""
        transaction = None
        try:
            if not self._rate.take():
                raise ValueError(f"more than {self._per_minute} requests a minute; ask again later")
            request = _request(payload)
            transaction = request.transaction
            return self._allowed(verb, request)
        except (GelgateError, TypeError, ValueError) as error:
            log.warning("command %.64r was refused: %s", verb, error)
            return self._answer(verb, transaction, error=str(error))
        except Exception:  # a sink's thread ends here: a request must not end it
            log.exception("command %.64r failed", verb)
            return self._answer(
                verb, transaction, error="it failed with an internal error; see the gateway's log"
            )

    def refused(self, verb: str, payload: bytes, why: str) -> bytes:
        """The response to a request that a sink refuses unread; a `Station.on_refused`."""
        try:
            transaction = _request(payload).transaction
        except ValueError:
            transaction = None
        return self._answer(verb, transaction, error=why)

    def _allowed(self, verb: str, request: CommandRequest) -> bytes:
        """Record the request, do it unless it was done before, and record its outcome. Errors: those of a handler."""
        now_ns = self._clock.time_ns()
        why = self._unknown(verb) or self._policy.refusal(verb, request, now_ns)
        signed = why is None and verb in self._policy.signed
        act = Act(
            now_ns,
            f"{request.by or 'unnamed'}, over MQTT, {'signed' if signed else 'unsigned'}",
            verb[:64],
            request.transaction,
            request.arguments,
            request.signature if signed else None,
        )
        if why is not None:
            self._store.begin_act(replace(act, outcome="refused", sentence=why), REPEATED_WITHIN_S)
            raise ValueError(why)
        act_id, earlier = self._store.begin_act(act, REPEATED_WITHIN_S)
        if earlier is not None:
            return self._repeated(act, earlier)
        return self._done(verb, request, act_id)

    def _unknown(self, verb: str) -> str | None:
        if verb in self._handlers:
            return None
        return f"no command is named '{verb[:64]}'; known: {', '.join(sorted(self._handlers)) or 'none'}"

    def _done(self, verb: str, request: CommandRequest, act_id: int) -> bytes:
        try:
            change = self._handlers[verb](request.arguments)
        except Exception as error:
            self._keep(act_id, "failed", str(error))
            raise
        log.info("command %s was done for %s", verb, request.by or "an unnamed client")
        self._keep(act_id, "done", None, change.before, change.after)
        return self._answer(verb, request.transaction, data=change.data)

    def _keep(self, act_id: int, *outcome: Any) -> None:
        """What was done stays done when its outcome cannot be written."""
        try:
            self._store.finish_act(act_id, *outcome)
        except StoreError as error:
            log.error("the outcome of a request is not recorded: %s", error)

    def _repeated(self, act: Act, earlier: Act) -> bytes:
        if (earlier.verb, dict(earlier.arguments)) != (act.verb, dict(act.arguments)):
            error: str | None = (
                "this transaction id was used for another request within a minute; choose another"
            )
        elif earlier.outcome is None:
            error = "this request is being done, or was interrupted; see the station's state"
        else:
            error = earlier.sentence
        return self._answer(act.verb, act.request, error, earlier.after, is_repeated=True)

    def _answer(
        self,
        verb: str,
        transaction: str | None,
        error: str | None = None,
        data: Mapping[str, Any] | None = None,
        is_repeated: bool = False,
    ) -> bytes:
        return CommandResponse(
            time_ns=self._clock.time_ns(),
            transaction=transaction,
            verb=verb[:64],
            status="ok" if error is None else "error",
            error=error,
            data=dict(data or {}),
            is_repeated=is_repeated,
        ).encode()


def _request(payload: bytes) -> CommandRequest:
    """Errors: ValueError, one sentence."""
    try:
        return CommandRequest.model_validate_json(payload)
    except ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(str(part) for part in fault["loc"]) or "the request"
        raise ValueError(f"{where}: {fault['msg']}; see docs/mqtt.md") from error
