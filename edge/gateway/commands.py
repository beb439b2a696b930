"""Requests that arrive over MQTT or from a page: read, allowed or refused, recorded, done once, and answered.

Every fault becomes a response; no request can stop the gateway. `command_table` has the verbs, `CommandPolicy` says who
may ask for what. A request is recorded before it is done, and completed with its outcome: a repetition gets that
outcome, and is not done again.
"""

import logging
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from pydantic import ValidationError

from edge.config import Config
from edge.config.loading import read_secret
from edge.core.errors import GelgateError, StoreError
from edge.core.ports import Clock
from edge.core.rate import Rate
from edge.messaging.command_payloads import (
    SHORTEST_SECRET,
    CommandRequest,
    CommandResponse,
    CommandTransaction,
    describe_fault,
    is_signed,
    signed_text,
)
from edge.store.acts import Act
from edge.store.press_store import Store

__all__ = [
    "REPEATED_WITHIN_S",
    "SIGNED_WITHIN_S",
    "Change",
    "CommandPolicy",
    "Commands",
    "Handler",
    "policy_of",
]

log = logging.getLogger(__name__)

# The same transaction id within this time is the same request: MQTT delivers at least once.
REPEATED_WITHIN_S: Final = 60.0

# Who asked, in the table of acts: a person at a page, where he gave no name.
PAGE: Final = "page"

# Each kind of request has a rate of its own, taken when it is known who asks: nobody uses up that of another.
_KINDS: Final = ("signed", "unsigned", PAGE, "refused", "refused at the page", "logged")

# The time in a signed request and the station's clock may differ by this.
SIGNED_WITHIN_S: Final = 60.0


@dataclass(frozen=True)
class CommandPolicy:
    """root: of the station's topics. unsigned: verbs for everybody whom the broker lets publish; signed: verbs that
    need a signature with `secret`; page: verbs for a person at the page, whom the page has admitted. All others are
    off."""

    root: str
    unsigned: frozenset[str]
    signed: frozenset[str] = frozenset()
    secret: bytes | None = None
    page: frozenset[str] = frozenset()

    def page_refusal(self, verb: str) -> str | None:
        """Say why a request from the page is not done, as one sentence; None if it may be."""
        if verb in self.page:
            return None
        return (
            f"the command '{verb:.64}' is off at the page of this station; name it in [commands] of its configuration, "
            "under page"
        )

    def refusal(self, verb: str, request: CommandRequest, now_ns: int) -> str | None:
        """Say why this request is not done, as one sentence; None if it may be. now_ns: wall clock."""
        if verb in self.unsigned:
            return None
        if verb not in self.signed or self.secret is None:
            return (
                f"the command '{verb:.64}' is off at this station; name it in [commands] of its configuration, "
                "under signed or unsigned"
            )
        if request.signature is None or request.time_ns is None:
            return f"the command '{verb:.64}' needs time_ns and signature; see docs/mqtt.md"
        arguments = (request.transaction, request.time_ns, request.by, request.arguments)
        if not is_signed(self.secret, signed_text(self.root, verb, *arguments), request.signature):
            return "the signature is not that of this request and this station's secret"
        apart_s = abs(now_ns - request.time_ns) / 1e9
        if apart_s > SIGNED_WITHIN_S:
            return (
                f"the request was signed {apart_s:.0f} s away from this station's clock, at most {SIGNED_WITHIN_S:g} s "
                "are allowed; compare the clocks"
            )
        return None


@dataclass(frozen=True)
class Change:
    """What a request did. before, after: gel and contact, for the table of acts. All are plain JSON."""

    data: Mapping[str, Any]
    """The data of the response."""
    before: Mapping[str, Any] | None = None
    after: Mapping[str, Any] | None = None


Handler = Callable[[Mapping[str, Any]], Change]
"""Arguments of the request -> what was done. Errors: GelgateError, TypeError, ValueError."""


@dataclass(frozen=True)
class _Asked:
    """who: for the table of acts. why: it is refused, None if it may be done. kind: whose rate it takes. signature:
    that was checked."""

    who: str
    why: str | None
    kind: str
    signature: str | None = None


_Admit = Callable[[str, CommandRequest, int], _Asked]
"""(verb, request, wall clock in nanoseconds) -> who asks, and whether he may."""


class Commands:
    """Verbs and their handlers; a `Station.on_command`. Handlers are called from the sinks' threads.

    store: keeps the acts. per_minute: requests of one kind that are served; more are refused, and not recorded. As many
    that are not admitted are recorded and have a line in the log; more are answered alone.
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
        self._rates = {kind: Rate(per_minute, clock) for kind in _KINDS}
        self._flood_lines = Rate(1, clock)
        # A signature is valid for two minutes, in which three times the rate may come: what is left at first, and two.
        self._signatures: deque[str] = deque(maxlen=3 * per_minute)

    def __call__(self, verb: str, payload: bytes) -> bytes:
        """The response to one request over MQTT."""
        return self._response(verb, payload, self._over_mqtt)

    @property
    def page_verbs(self) -> frozenset[str]:
        """The verbs that a page may serve."""
        return self._policy.page & self._handlers.keys()

    def from_page(self, verb: str, payload: bytes) -> bytes:
        """The response to one request of a person whom a page has admitted."""
        return self._response(verb, payload, self._at_page)

    def refuse_at_page(self, verb: str, payload: bytes, why: str) -> bytes:
        """Return the response to a request that a page refuses, such as without its token. It is recorded."""
        self._warn(verb, f"{why} (at the page)")
        transaction = _transaction(payload)
        act = Act(self._clock.time_ns(), PAGE, verb[:64], transaction, outcome="refused", sentence=why)
        if self._rates["refused at the page"].take():
            try:
                self._store.begin_act(act)
            except StoreError as error:
                log.error("a refused request is not recorded: %s", error)
        return self._answer(verb, transaction, error=why)

    def _response(self, verb: str, payload: bytes, admit: _Admit) -> bytes:
        transaction = _transaction(payload)
        try:
            return self._do_once(verb, _request(payload), admit)
        except (GelgateError, TypeError, ValueError) as error:
            self._warn(verb, error)
            return self._answer(verb, transaction, error=str(error))
        except Exception:  # a sink's thread ends here: a request must not end it
            log.exception("command %.64r failed", verb)
            return self._answer(
                verb, transaction, error="it failed with an internal error; see the gateway's log"
            )

    def _warn(self, verb: str, why: object) -> None:
        """A line for each request that is not done; of a flood one line a minute."""
        if self._rates["logged"].take():
            log.warning("command %.64r was refused: %s", verb, why)
        elif self._flood_lines.take():
            log.warning("more than %d requests a minute are refused: not each has its line", self._per_minute)

    def refuse(self, verb: str, payload: bytes, why: str) -> bytes:
        """Return the response to a request that a sink refuses unread; a `Station.on_refused`."""
        return self._answer(verb, _transaction(payload), error=why)

    def _over_mqtt(self, verb: str, request: CommandRequest, now_ns: int) -> _Asked:
        why = self._policy.refusal(verb, request, now_ns)
        signature = request.signature if why is None and verb in self._policy.signed else None
        kind = "unsigned" if signature is None else "signed"
        who = f"{request.by or 'unnamed'}, over MQTT, {kind}"
        if why is not None or signature in self._signatures:  # anybody may send a copy again
            kind = "refused"
        return _Asked(who, why, kind, signature)

    def _at_page(self, verb: str, request: CommandRequest, now_ns: int) -> _Asked:
        who = PAGE if request.by is None else f"{request.by}, at the {PAGE}"
        return _Asked(who, self._policy.page_refusal(verb), PAGE)

    def _do_once(self, verb: str, request: CommandRequest, admit: _Admit) -> bytes:
        """Record the request, do it unless it was done before, and record its outcome. Errors: those of a handler."""
        now_ns = self._clock.time_ns()
        asked = admit(verb, request, now_ns)
        why = asked.why
        act = Act(now_ns, asked.who, verb[:64], request.transaction, request.arguments, asked.signature)
        is_within_rate = self._rates[asked.kind].take()
        if why is not None and is_within_rate:
            self._store.begin_act(replace(act, outcome="refused", sentence=why))
        if why is not None or not is_within_rate:
            raise ValueError(why or f"more than {self._per_minute} requests a minute; ask again later")
        if asked.signature is not None:
            self._signatures.append(asked.signature)
        act_id, earlier = self._store.begin_act(act, REPEATED_WITHIN_S)
        if earlier is not None:
            return self._repeated(act, earlier)
        return self._done(verb, request, act_id)

    def _done(self, verb: str, request: CommandRequest, act_id: int) -> bytes:
        try:
            change = self._handlers[verb](request.arguments)
        except Exception as error:
            self._keep(act_id, "failed", str(error))
            raise
        log.info("command %s was done for %s", verb, request.by or "an unnamed client")
        self._keep(act_id, "done", None, change.before, change.after)
        return self._answer(verb, request.transaction, data=dict(change.data))

    def _keep(self, act_id: int, *outcome: Any) -> None:
        """Write the outcome; where that fails, what was done stays done."""
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
        return self._answer(act.verb, act.request, error, data=dict(earlier.after or {}), is_repeated=True)

    def _answer(self, verb: str, transaction: str | None, error: str | None = None, **more: Any) -> bytes:
        return CommandResponse.of(self._clock.time_ns(), verb, error, transaction, **more).encode()


def _transaction(payload: bytes) -> str | None:
    """Return the transaction of a request, also where all else of it is wrong; None where it cannot be read."""
    try:
        return CommandTransaction.model_validate_json(payload).transaction
    except ValidationError:
        return None


def _request(payload: bytes) -> CommandRequest:
    """Read a request. Errors: ValueError, one sentence."""
    try:
        return CommandRequest.model_validate_json(payload)
    except ValidationError as error:
        fault = dict(error.errors()[0])
        raise ValueError(f"{describe_fault(fault, 'the request')}; see docs/mqtt.md") from error


def policy_of(config: Config) -> CommandPolicy:
    """Return the configured policy. Errors: ConfigError for a secret that cannot be read."""
    table = config.commands
    return CommandPolicy(
        config.station.place.root,
        frozenset(table.unsigned),
        frozenset(table.signed),
        None
        if table.secret_file is None
        else read_secret(table.secret_file, "commands.secret_file", SHORTEST_SECRET),
        frozenset(table.page),
    )
