"""Posts every message of a station to a URL, with its topic behind it."""

import urllib.error
import urllib.request

from pydantic import BaseModel, Field

from edge.core.errors import SinkRejected, SinkUnavailable
from edge.core.plugins import SinkPlugin
from edge.core.ports import Message
from edge.core.sink_context import Station


class SinkOptions(BaseModel, extra="forbid", frozen=True):
    """The keys of its table in the configuration."""

    url: str = Field(pattern="^https?://", description="the topic is put behind it")
    timeout_s: float = Field(default=5.0, gt=0, description="how long the server may take")


class Sink:
    """`send` returns when the receiver has the message: the outbox then deletes it."""

    def __init__(self, options: SinkOptions, station: Station) -> None:
        self._options, self._station = options, station

    def send(self, message: Message) -> None:
        """Post it. Errors: SinkUnavailable, it is sent again; SinkRejected, it is set aside."""
        url = f"{self._options.url}/{self._station.topic(message)}"
        request = urllib.request.Request(url, message.payload, {"Content-Type": message.content_type})
        try:
            with urllib.request.urlopen(request, timeout=self._options.timeout_s) as answer:
                reached = answer.url
        except urllib.error.HTTPError as error:
            error.close()  # it is the answer too, with the connection
            kind = SinkRejected if error.code < 500 else SinkUnavailable
            raise kind(f"{url} answers {error.code} {error.reason}; see the server's log") from error
        except OSError as error:
            raise SinkUnavailable(f"{url} cannot be reached: {error}; is the server running?") from error
        if reached != url:  # Python asks there without the message
            raise SinkRejected(f"{url} leads to {reached}, and nothing was posted; name that in `url`")

    def close(self) -> None:
        """Nothing stays open between messages."""


class Plugin(SinkPlugin[SinkOptions]):
    """What the entry point names."""

    Options = SinkOptions

    def open(self, options: SinkOptions, station: Station) -> Sink:
        """Return at once: a receiver that is away is no error."""
        return Sink(options, station)


plugin = Plugin()
