"""The place of a gateway in the plant, and the context that a sink needs."""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from edge.core.ports import Message

__all__ = ["TOPIC_VERSION", "PageRequests", "Place", "Station", "topic_level"]

# The version of topics and payloads together; it rises only when a subscriber of the old one would misread the new.
TOPIC_VERSION = "v1"

# One level of a topic: wildcards (+ #), separators (/), broker-internal names ($) and blanks would change its meaning;
# a NUL is refused by every broker (MQTT 3.1.1, 1.5.3).
_LEVEL = re.compile(r"[^\s+#/$\x00]{1,64}")

OnCommand = Callable[[str, bytes], bytes]
"""(verb, request payload) -> response payload. It reports every fault in the response and never raises."""

OnRefused = Callable[[str, bytes, str], bytes]
"""(verb, request payload, why the sink refuses it unread) -> response payload. Quick, from any thread; never raises."""


@dataclass(frozen=True)
class PageRequests:
    """Requests of a person at a page, whom the page itself admits, such as by a token."""

    verbs: frozenset[str]
    """The verbs that may be served."""
    do: OnCommand
    """Does and answers one that is admitted."""
    refuse: OnRefused
    """Records and answers one that is not."""


def topic_level(text: str) -> str:
    """The text, if it can be one level of a topic. Errors: ValueError."""
    if not _LEVEL.fullmatch(text):
        raise ValueError("a topic level has 1 to 64 characters, no blank, and none of + # / $")
    return text


@dataclass(frozen=True)
class Place:
    """The place of a station in the plant; each is one level of its topics."""

    site: str
    line: str
    station: str
    prefix: str = "gelgate"

    def __str__(self) -> str:
        return f"{self.site}/{self.line}/{self.station}"

    @property
    def root(self) -> str:
        """The root of its topics."""
        return f"{self.prefix}/{self}/gel/{TOPIC_VERSION}"

    @property
    def client_id(self) -> str:
        """The station's name at a broker, different for every root.

        `gelgate-<site>-<line>-<station>`; where another prefix or a hyphen in a level would make two of them equal, it
        ends with a hash of the root.
        """
        name = f"gelgate-{self.site}-{self.line}-{self.station}"
        if self.prefix == "gelgate" and name.count("-") == 3:
            return name
        return f"{name}-{hashlib.sha256(self.root.encode()).hexdigest()[:8]}"


@dataclass(frozen=True)
class Station:
    """The context of a sink."""

    root: str
    """Stands before every message's topic, without a final slash."""
    client_id: str
    """Stable and unique in the plant."""
    will: Message | None = None
    """Left with the broker, which publishes it when this gateway disappears."""
    offline: Message | None = None
    """A second will, where a receiver can hold one."""
    birth: Callable[[], Sequence[Message]] = tuple
    """The first messages of every connection, requested each time."""
    on_command: OnCommand | None = None
    """Answers requests; None where commands are not served."""
    on_refused: OnRefused | None = None
    """Makes the answer to a request that the sink refuses; None for no answer."""
    page: PageRequests | None = None
    """For sinks that people use."""
    picture_type: str = "image/jpeg"
    """Content type of the pictures of presses."""
    draw: Callable[[str], bytes] | None = None
    """Draws the picture of an archived press, for those who look at it later; empty where it cannot. From any thread;
    never raises."""
    earlier: Callable[[int], Sequence[Mapping[str, Any]]] = lambda most: ()
    """The newest presses of before the start, at most so many, oldest first: what is kept of their results. Never
    raises."""

    def __post_init__(self) -> None:
        if not self.root or self.root.startswith("/") or self.root.endswith("/"):
            raise ValueError(f"a topic root has no slash at its ends, found {self.root!r}")
        if not self.client_id:
            raise ValueError("a station needs a client id, found an empty one")

    def topic(self, message: Message) -> str:
        """The full topic of a message."""
        return f"{self.root}/{message.topic}"
