"""A page for the people at the station: the last verdict with its picture, the presses before, gel, alarms, state.

It is a sink like the others: it gets what a broker gets, and goes on while brokers are away. It is served on the
loopback address unless other machines are named. With a token a person selects the part, acknowledges an alarm and
records a new gel; the station does these as requests that come over MQTT, and keeps them in its table of acts.

A port that another program has, or an address that is not up yet, stops no inspection: the page is served once it can
be, and the alarm `receiver` says why it is not.

What it does not do: it keeps nothing on the disk, so of presses before the start of the gateway it shows what the
history and the archive have; it shows no live picture; it does not encrypt.
"""

import os
import socket
from functools import partial

from edge.clock import SystemClock
from edge.core.errors import ConfigError, SinkRejected
from edge.core.plugins import SinkPlugin
from edge.core.ports import Clock, Message
from edge.core.sink_context import Station
from edge.page.server import PageServer
from edge.page.settings import PageSettings
from edge.page.shown import EARLIER_PRESSES, Shown

__all__ = ["Page", "PageOptions", "PageSink", "plugin"]


class PageOptions(PageSettings):
    """Where the page is: by default http://127.0.0.1:<port>/, for a browser on this machine, and nothing can be changed
    with it."""

    def identity(self) -> str:
        """There is one page at a port."""
        return str(self.port)

    def warnings(self) -> list[str]:
        """Say what is open to others, and a port that is taken. Errors: ConfigError for a token that cannot be used."""
        sentences, family = super().warnings(), socket.AF_INET6 if ":" in self.bind else socket.AF_INET
        try:
            socket.create_server((self.bind, self.port), family=family).close()
        except OSError as error:
            sentences.append(
                f"{self.bind}:{self.port} cannot be served now ({os.strerror(error.errno or 0)}): this station serves "
                "it where it runs; else presses are inspected without the page until it is free: choose another port"
            )
        return sentences


class PageSink:
    """Serves the page until `close`. port 0: a free one. Errors: ConfigError for a token that cannot be used."""

    def __init__(
        self, options: PageSettings, station: Station, clock: Clock, port: int | None = None
    ) -> None:
        place, earlier = "/".join(station.root.split("/")[1:-2]), station.earlier(EARLIER_PRESSES)
        self._shown = Shown(place, draw=station.draw, earlier=earlier)
        options.token()
        self._open = partial(PageServer, self._shown, options, station.page, clock, port=port)
        self._server: PageServer | None = None
        self.faults: tuple[str, ...] = ()
        """Why the page is not served."""
        self._serve()

    @property
    def port(self) -> int:
        """The port at which it is served; 0 while it is not."""
        return self._server.port if self._server else 0

    def _serve(self) -> None:
        try:
            self._server, self.faults = self._open(), ()
        except ConfigError as error:
            self.faults = (str(error),)

    def send(self, message: Message) -> None:
        """Show it. Errors: SinkRejected for what is no message of a station."""
        if self.faults:
            self._serve()
        try:
            self._shown.see(message)
        except ValueError as error:
            raise SinkRejected(f"the message on {message.topic} cannot be shown: {error}") from error

    def close(self) -> None:
        self.faults = ()
        if self._server is not None:
            self._server.close()


class Page(SinkPlugin[PageOptions]):
    """The plugin."""

    Options = PageOptions

    def open(self, options: PageOptions, station: Station) -> PageSink:
        """The page with the birth messages of the station. Errors: ConfigError for a token that cannot be used."""
        sink = PageSink(options, station, SystemClock())
        for message in station.birth():
            sink.send(message)
        return sink


plugin = Page()
