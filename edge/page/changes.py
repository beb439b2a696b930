"""What a person changes with the page: one request is admitted or refused, done by the station, and answered.

A page of somebody else in the same browser can send requests here. So a change comes from the page's own origin, as
JSON and with a token, none of which another page can send.

Ref: Fetch standard, "Origin header" and "CORS protocol"; OWASP, Cross-Site Request Forgery Prevention.
"""

import hashlib
import hmac
import re
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, Final

from edge.core.ports import Clock
from edge.core.rate import Rate
from edge.core.sentence import Sentence
from edge.core.sink_context import PageRequests
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES, CommandResponse
from edge.page.access import Refused

__all__ = ["READ_ONLY", "UNLOCK", "AddressRates", "Changes", "change_refusal", "is_verb"]

# Wrong tokens a minute from one address; then its requests are refused, also with the right one.
WRONG_PER_MINUTE: Final = 10

# Addresses that are counted; of more the oldest is forgotten.
MOST_ADDRESSES: Final = 256

READ_ONLY: Final = Sentence("this page only shows: no token is configured for it")

# Requests of other pages that are recorded for one address; more would push guesses at the token out of the table.
FOREIGN_PER_MINUTE: Final = 1

# Asks for nothing but whether the token is right.
UNLOCK: Final = "unlock"

_VERB: Final = re.compile(r"[a-z_]{1,64}")


class AddressRates:
    """At most this number of events a minute for each address."""

    def __init__(self, per_minute: int, clock: Clock) -> None:
        self._per_minute = per_minute
        self._clock = clock
        self._rates: OrderedDict[str, Rate] = OrderedDict()

    def of(self, client: str) -> Rate:
        """Give the rate of one address."""
        rate = self._rates.setdefault(client, Rate(self._per_minute, self._clock))
        while len(self._rates) > MOST_ADDRESSES:
            self._rates.popitem(last=False)
        return rate


class Changes:
    """The requests of the people at one page, who have its token. Any thread may use it.

    station: does and records them; None where nothing can be changed. token: None admits no one. why_not: why nothing
    can be changed, for the page.
    """

    def __init__(
        self, station: PageRequests | None, token: bytes | None, clock: Clock, why_not: str = READ_ONLY
    ) -> None:
        self._station = station
        self._digest = None if token is None else _digest(token)
        self._wrong = AddressRates(WRONG_PER_MINUTE, clock)
        self._foreign = AddressRates(FOREIGN_PER_MINUTE, clock)
        self._clock = clock
        self._why_not = why_not

    def offer(self) -> dict[str, Any]:
        """Tell the page which verbs it offers, or why it offers none."""
        if self._station is None or self._digest is None:
            return {"verbs": [], "why_not": self._why_not}
        return {"verbs": sorted(self._station.verbs), "why_not": None}

    def refusal(self, client: str, headers: Mapping[str, str]) -> Refused | None:
        """Say why nothing is done for this request, from its headers alone. Their names are in lower case."""
        if self._station is None:
            return Refused(403, self._why_not)
        refused = self._too_large(headers) or change_refusal(headers)
        if refused is None:
            return self.token_refusal(client, headers.get("authorization", ""))
        return refused._replace(is_recorded=refused.is_recorded and self._foreign.of(client).take())

    def token_refusal(self, client: str, authorization: str) -> Refused | None:
        """Say why this header, `Bearer <token>`, does not open. It is compared in constant time."""
        wrong = self._wrong.of(client)
        if wrong.is_exhausted:
            return Refused(
                429,
                Sentence(
                    f"more than {WRONG_PER_MINUTE} wrong tokens a minute from {client}; wait some seconds"
                ),
            )
        kind, _, given = authorization.partition(" ")
        if self._digest is None:
            refused = Refused(403, READ_ONLY, is_recorded=True)
        elif kind.lower() != "bearer" or not given.strip():
            refused = Refused(401, Sentence("a change needs the token of this page"), is_recorded=True)
        elif not hmac.compare_digest(_digest(given.strip().encode()), self._digest):
            refused = Refused(401, Sentence("this is not the token of this page"), is_recorded=True)
        else:
            return None
        wrong.take()
        return refused

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
        return CommandResponse.of(self._clock.time_ns(), verb, error).encode()


def _digest(token: bytes) -> bytes:
    """Hash the token to one length, so that the comparison does not tell how long it is."""
    return hashlib.sha256(token).digest()


def is_verb(text: str) -> bool:
    """Tell whether this can be a verb."""
    return _VERB.fullmatch(text) is not None


def change_refusal(headers: Mapping[str, str]) -> Refused | None:
    """Say why a change with these headers is refused: from another page, or not JSON. Names in lower case."""
    origin, site = headers.get("origin"), headers.get("sec-fetch-site", "same-origin")
    own = headers.get("host", "").lower()
    if site not in ("same-origin", "none") or (origin is not None and _origin(origin) != own):
        return Refused(403, "this request comes from another page; only this one may ask for a change", True)
    if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        return Refused(415, "a request is sent as application/json")
    return None


def _origin(origin: str) -> str:
    """Host and port of an `Origin` header; empty for `null` and everything else."""
    scheme, sign, rest = origin.strip().lower().partition("://")
    return rest if sign and scheme in ("http", "https") else ""
