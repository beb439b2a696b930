"""A page for the people at the station: the last verdict with its picture, the presses before, gel, alarms, state.

It is a sink like the others: it gets what a broker gets, and goes on while brokers are away. It is served on the
loopback address alone, so in a browser on this machine; there is no login and nothing to change. It shows what came
since the start of the gateway.

    /                 the page; one file each of HTML, CSS and JavaScript, no other is loaded
    /station.json     state, info, gel, stats and alarms, the newest of each
    /presses.json     the newest results, newest first
    /pictures/<press id>.png

What it does not do: it keeps nothing on the disk, shows no live picture, and takes no command.
"""

import json
import threading
from collections import OrderedDict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, ClassVar, Final

from pydantic import BaseModel, ConfigDict, Field

from edge.core.errors import ConfigError, SinkRejected
from edge.core.plugins import SinkPlugin
from edge.core.ports import Message
from edge.core.sink_context import Station

__all__ = ["Page", "PageOptions", "PageSink", "plugin"]

ADDRESS: Final = "127.0.0.1"

# Results that are shown, and of how many the picture is kept; a picture has at most 2 MiB.
MOST_PRESSES: Final = 50
MOST_PICTURES: Final = 12

# A browser that is slower than this with its request is left.
REQUEST_S: Final = 5.0

# The names of this machine: with another one the page was reached through a name server of others.
_OWN_NAMES: Final = ("127.0.0.1", "localhost")

_FILES: Final = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}


class PageOptions(BaseModel):
    """Where the page is: http://127.0.0.1:<port>/ on this machine."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: int = Field(default=8080, ge=1024, le=65535, description="TCP port")

    def identity(self) -> str:
        """There is one page at a port."""
        return str(self.port)


class Shown:
    """The newest messages. Any thread may use it."""

    def __init__(self, root: str) -> None:
        self._lock = threading.Lock()
        self._station: dict[str, Any] = {"place": "/".join(root.split("/")[1:-2])}
        self._alarms: dict[str, Any] = {}
        self._presses: OrderedDict[str, Any] = OrderedDict()
        self._pictures: OrderedDict[str, bytes] = OrderedDict()

    def see(self, message: Message) -> None:
        """Errors: ValueError for what is no JSON object where one is expected."""
        kind, _, name = message.topic.partition("/")
        if kind == "heatmap":
            with self._lock:
                _keep(self._pictures, name, message.payload, MOST_PICTURES)
        elif kind == "alarm" and not message.payload:
            with self._lock:
                self._alarms.pop(name, None)
        elif message.topic in ("state", "info", "gel", "stats", "result") or kind == "alarm":
            content = json.loads(message.payload)
            if not isinstance(content, dict):
                raise ValueError("expected a JSON object")
            with self._lock:
                self._see(kind, name, content)

    def _see(self, kind: str, name: str, content: dict[str, Any]) -> None:
        if kind == "alarm":
            self._alarms[name] = content
        elif kind == "result":
            _keep(self._presses, str(content.get("press_id")), content, MOST_PRESSES)
        else:
            self._station[kind] = content

    def station(self) -> dict[str, Any]:
        """What the station says of itself."""
        with self._lock:
            return {**self._station, "alarms": dict(self._alarms)}

    def presses(self) -> list[Any]:
        """Newest first; `has_picture` says whether there is one."""
        with self._lock:
            return [
                {**one, "has_picture": key in self._pictures} for key, one in reversed(self._presses.items())
            ]

    def picture(self, press_id: str) -> bytes | None:
        with self._lock:
            return self._pictures.get(press_id)


def _keep(kept: OrderedDict[str, Any], key: str, value: Any, most: int) -> None:
    kept[key] = value
    while len(kept) > most:
        kept.popitem(last=False)


class PageSink:
    """Serves the page until `close`. Errors: ConfigError for a port that is taken."""

    def __init__(self, port: int, station: Station) -> None:
        self._shown = shown = Shown(station.root)

        class Handler(_Handler):
            content = shown

        try:
            self._server = ThreadingHTTPServer((ADDRESS, port), Handler)
        except OSError as error:
            raise ConfigError(
                f"the page cannot be served on {ADDRESS}:{port}: {error.strerror}; choose another port"
            ) from error
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)
        self._thread.start()

    def send(self, message: Message) -> None:
        """Show it. Errors: SinkRejected for what is no message of a station."""
        try:
            self._shown.see(message)
        except ValueError as error:
            raise SinkRejected(f"the message on {message.topic} cannot be shown: {error}") from error

    def close(self) -> None:
        """The page is gone. May be called again."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
            self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    content: ClassVar[Shown]
    timeout = REQUEST_S
    server_version, sys_version = "gelgate", ""

    def do_GET(self) -> None:
        name = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        if name not in _OWN_NAMES:
            self._answer(403, "text/plain; charset=utf-8", b"this page is for a browser on its own machine\n")
        elif self.path in _FILES:
            name, content_type = _FILES[self.path]
            self._answer(200, content_type, files("plugins.sinks.page_files").joinpath(name).read_bytes())
        elif self.path == "/station.json":
            self._json(self.content.station())
        elif self.path == "/presses.json":
            self._json(self.content.presses())
        else:
            self._picture()

    def _picture(self) -> None:
        press_id = self.path.removeprefix("/pictures/").removesuffix(".png")
        picture = self.content.picture(press_id)
        if picture is None:
            self._answer(404, "text/plain; charset=utf-8", b"there is no such page\n")
        else:
            self._answer(200, "image/png", picture)

    def _json(self, content: object) -> None:
        self._answer(200, "application/json", json.dumps(content).encode())

    def _answer(self, status: int, content_type: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header(
            "Content-Security-Policy", "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'"
        )
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: a page that is open asks every second."""


class Page(SinkPlugin[PageOptions]):
    """The plugin."""

    Options = PageOptions

    def open(self, options: PageOptions, station: Station) -> PageSink:
        """The page with the birth messages of the station. Errors: ConfigError for a port that is taken."""
        sink = PageSink(options.port, station)
        for message in station.birth():
            sink.send(message)
        return sink


plugin = Page()
