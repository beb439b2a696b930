"""Who may see the page and who may change something with it: addresses, names, the origin of a request, the token.

A page of somebody else in the same browser can send requests here. So a request names this page by an address or a name
that is known (against a name server that answers with our address), and a change comes from the page's own origin, as
JSON and with a token, none of which another page can send.

Ref: Fetch standard, "Origin header" and "CORS protocol"; OWASP, Cross-Site Request Forgery Prevention.
"""

import hashlib
import hmac
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import IPv4Network, IPv6Network, ip_address
from typing import Final, NamedTuple

from edge.core.ports import Clock
from edge.core.printable import printable
from edge.core.rate import Rate

__all__ = ["READ_ONLY", "Access", "AddressRates", "Network", "Refused", "TokenGate", "change_refusal"]

Network = IPv4Network | IPv6Network

# Wrong tokens a minute from one address; then its requests are refused, also with the right one.
WRONG_PER_MINUTE: Final = 10

# Addresses that are counted; of more the oldest is forgotten.
MOST_ADDRESSES: Final = 256

READ_ONLY: Final = "this page only shows: no token is configured for it"

_LONGEST_SHOWN: Final = 80


class Refused(NamedTuple):
    """status: of HTTP. is_recorded: whether it belongs into the table of acts."""

    status: int
    sentence: str
    is_recorded: bool = False


@dataclass(frozen=True)
class Access:
    """allow_from: addresses of other machines that may see the page. names: under which it is known besides its
    address."""

    allow_from: tuple[Network, ...] = ()
    names: tuple[str, ...] = ()

    def refusal(self, client: str, reached: str, host: str) -> Refused | None:
        """client: address of the asker. reached: our address to which he is connected. host: the header `Host`."""
        if not (_is_own(client) or any(_address(client) in network for network in self.allow_from)):
            return Refused(
                403,
                f"this page is not shown to {client}; name its address in allow_from of the page on the gateway",
            )
        name = _name(host)
        known = {_plain(reached), *(own.lower() for own in self.names)}
        if _is_own(reached):
            known |= {"localhost", "127.0.0.1", "::1"}
        if name in known:
            return None
        shown = printable(name[:_LONGEST_SHOWN])
        return Refused(
            403,
            f"this page is not known as '{shown}'; use its address ({reached}), or add the name to names of the page "
            "on the gateway",
        )


def change_refusal(headers: Mapping[str, str]) -> Refused | None:
    """Say why a change with these headers is refused: from another page, or not JSON. Names in lower case."""
    origin, site = headers.get("origin"), headers.get("sec-fetch-site", "same-origin")
    own = headers.get("host", "").lower()
    if site not in ("same-origin", "none") or (origin is not None and _origin(origin) != own):
        return Refused(403, "this request comes from another page; only this one may ask for a change", True)
    if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        return Refused(415, "a request is sent as application/json")
    return None


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


class TokenGate:
    """Admits who has the token. Any thread may use it. token: None admits no one."""

    def __init__(self, token: bytes | None, clock: Clock) -> None:
        self._digest = None if token is None else _digest(token)
        self._wrong = AddressRates(WRONG_PER_MINUTE, clock)

    @property
    def is_open(self) -> bool:
        """True where there is a token."""
        return self._digest is not None

    def refusal(self, client: str, authorization: str) -> Refused | None:
        """Say why this header, `Bearer <token>`, does not open. It is compared in constant time."""
        if self._wrong.of(client).is_exhausted:
            return Refused(
                429, f"more than {WRONG_PER_MINUTE} wrong tokens a minute from {client}; wait some seconds"
            )
        kind, _, given = authorization.partition(" ")
        if self._digest is None:
            return self._refuse(client, 403, READ_ONLY)
        if kind.lower() != "bearer" or not given.strip():
            return self._refuse(client, 401, "a change needs the token of this page")
        if not hmac.compare_digest(_digest(given.strip().encode()), self._digest):
            return self._refuse(client, 401, "this is not the token of this page")
        return None

    def _refuse(self, client: str, status: int, sentence: str) -> Refused:
        self._wrong.of(client).take()
        return Refused(status, sentence, is_recorded=True)


def _digest(token: bytes) -> bytes:
    """Hash the token to one length, so that the comparison does not tell how long it is."""
    return hashlib.sha256(token).digest()


def _plain(address: str) -> str:
    """Remove the zone, and write IPv4 as IPv4 where a socket for both has it as IPv6."""
    plain = ip_address(address.partition("%")[0])
    mapped = getattr(plain, "ipv4_mapped", None)
    return str(mapped or plain)


def _address(text: str) -> object:
    return ip_address(_plain(text))


def _is_own(address: str) -> bool:
    return ip_address(_plain(address)).is_loopback


def _name(host: str) -> str:
    """The name in a `Host` header, without the port and the brackets of IPv6."""
    if host.startswith("["):
        return host[1:].partition("]")[0].lower()
    return host.partition(":")[0].strip().lower().rstrip(".")


def _origin(origin: str) -> str:
    """Host and port of an `Origin` header; empty for `null` and everything else."""
    scheme, sign, rest = origin.strip().lower().partition("://")
    return rest if sign and scheme in ("http", "https") else ""
