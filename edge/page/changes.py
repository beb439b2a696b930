"""What a person changes with the page: one request is admitted or refused, done by the station, and answered."""

import re
from collections.abc import Mapping
from typing import Any, Final

from edge.core.ports import Clock
from edge.core.sink_context import PageRequests
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES, CommandResponse
from edge.page.access import READ_ONLY, AddressRates, Refused, TokenGate, change_refusal

__all__ = ["UNLOCK", "Changes", "is_verb"]

# Requests of other pages that are recorded for one address; more would push guesses at the token out of the table.
FOREIGN_PER_MINUTE: Final = 1

# Asks for nothing but whether the token is right.
UNLOCK: Final = "unlock"

_VERB: Final = re.compile(r"[a-z_]{1,64}")


class Changes:
    """The requests of the people at one page. Any thread may use it.

    station: does and records them; None where nothing can be changed. why_not: why, for the page.
    """

    def __init__(
        self, station: PageRequests | None, gate: TokenGate, clock: Clock, why_not: str = READ_ONLY
    ) -> None:
        self._station = station
        self._gate = gate
        self._foreign = AddressRates(FOREIGN_PER_MINUTE, clock)
        self._clock = clock
        self._why_not = why_not

    def offer(self) -> dict[str, Any]:
        """Tell the page which verbs it offers, or why it offers none."""
        if self._station is None or not self._gate.is_open:
            return {"verbs": [], "why_not": self._why_not}
        return {"verbs": sorted(self._station.verbs), "why_not": None}

    def refusal(self, client: str, headers: Mapping[str, str]) -> Refused | None:
        """Say why nothing is done for this request, from its headers alone. Their names are in lower case."""
        if self._station is None:
            return Refused(403, self._why_not)
        refused = self._too_large(headers) or change_refusal(headers)
        if refused is None:
            return self._gate.refusal(client, headers.get("authorization", ""))
        return refused._replace(is_recorded=refused.is_recorded and self._foreign.of(client).take())

    def _too_large(self, headers: Mapping[str, str]) -> Refused | None:
        if "content-length" not in headers:
            return Refused(411, "a request says how many bytes it has (Content-Length)")
        length = int(headers["content-length"])
        if length > LARGEST_REQUEST_BYTES:
            return Refused(413, f"a request has at most {LARGEST_REQUEST_BYTES} bytes, this one has {length}")
        return None

    def refuse(self, verb: str, payload: bytes, refused: Refused) -> bytes:
        """The answer to a request that is not done; it is recorded where that is asked."""
        if self._station is not None and refused.is_recorded:
            return self._station.refuse(verb, payload, refused.sentence)
        return self._answer(verb, refused.sentence)

    def do(self, verb: str, payload: bytes) -> bytes:
        """The answer to a request that is admitted."""
        if self._station is None:
            return self._answer(verb, self._why_not)
        if verb == UNLOCK:
            return self._answer(verb)
        return self._station.do(verb, payload)

    def _answer(self, verb: str, error: str | None = None) -> bytes:
        return CommandResponse(
            time_ns=self._clock.time_ns(),
            transaction=None,
            verb=verb,
            status="ok" if error is None else "error",
            error=error,
        ).encode()


def is_verb(text: str) -> bool:
    """Tell whether this can be a verb."""
    return _VERB.fullmatch(text) is not None
