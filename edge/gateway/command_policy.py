"""Who may ask for what: verbs that are served, the signature of those that change something."""

from dataclasses import dataclass
from typing import Final

from edge.config import Config
from edge.config.secret_file import read_secret
from edge.core.sink_context import topic_root
from edge.messaging.command_payloads import SHORTEST_SECRET, CommandRequest, is_signed, signed_text

__all__ = ["CommandPolicy", "policy_of"]

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


def policy_of(config: Config) -> CommandPolicy:
    """Return the configured policy. Errors: ConfigError for a secret that cannot be read."""
    table, station = config.commands, config.station
    return CommandPolicy(
        topic_root(station.prefix, station.site, station.line, station.station),
        frozenset(table.unsigned),
        frozenset(table.signed),
        None
        if table.secret_file is None
        else read_secret(table.secret_file, "commands.secret_file", SHORTEST_SECRET),
        frozenset(table.page),
    )
