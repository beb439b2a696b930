"""Who may see the page: addresses of machines, and the names under which the page is known.

A request names the page by an address or a name that is known, against a name server that answers with our address.
"""

from dataclasses import dataclass
from ipaddress import IPv4Network, IPv6Network, ip_address
from typing import Final, NamedTuple

from edge.core.printable import printable

__all__ = ["Access", "Network", "Refused"]

Network = IPv4Network | IPv6Network

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
        if not (_is_own(client) or any(ip_address(_plain(client)) in network for network in self.allow_from)):
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


def _plain(address: str) -> str:
    """Remove the zone, and write IPv4 as IPv4 where a socket for both has it as IPv6."""
    plain = ip_address(address.partition("%")[0])
    mapped = getattr(plain, "ipv4_mapped", None)
    return str(mapped or plain)


def _is_own(address: str) -> bool:
    return ip_address(_plain(address)).is_loopback


def _name(host: str) -> str:
    """The name in a `Host` header, without the port and the brackets of IPv6."""
    if host.startswith("["):
        return host[1:].partition("]")[0].lower()
    return host.partition(":")[0].strip().lower().rstrip(".")
