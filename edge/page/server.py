"""The page over HTTP: its three files, what it shows as JSON, pictures, and requests of the people at it.

    /                            the page; one file each of HTML, CSS and JavaScript, no other is loaded
    /live.json?after=<version>   everything that is shown; answered when there is another version, or after a while
    /station.json                state, info, gel, reference, stats, alarms with what to do, and what may be changed
    /state.json, /info.json, /gel.json, /reference.json, /stats.json, /alarms.json    one of these
    /presses.json                the newest results, newest first
    /pictures/<press id>.png
    POST /requests/<verb>        a request as on `cmd/<verb>`, with `Authorization: Bearer <token>`

A status other than 200 says that the request was not admitted; how an admitted one ended is in its answer.
"""

import json
import threading
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from socket import AF_INET, AF_INET6, SHUT_RDWR, socket
from typing import Any, ClassVar, Final
from urllib.parse import parse_qs, urlsplit

from edge.core.errors import ConfigError
from edge.page.access import Access
from edge.page.changes import Changes, is_verb
from edge.page.shown import Shown

__all__ = ["PageServer"]

# A browser that is slower than this with its request, or silent for this time after an answer, is left.
REQUEST_S: Final = 10.0

# A browser that waits for news is answered after this time without any.
NEWS_S: Final = 15.0

# Connections at once, and those of one address; a browser opens up to six.
MOST_CONNECTIONS: Final = 64
MOST_OF_ONE: Final = 24

# The server looks this often whether it is closed.
CLOSING_S: Final = 0.1

# Of a request that is too large this much is read before it is answered: a browser that is cut off shows no answer.
READ_OF_TOO_LARGE: Final = 1 << 20

_FILES: Final = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}

_PARTS: Final = ("state", "info", "gel", "reference", "stats", "alarms")

_TEXT: Final = "text/plain; charset=utf-8"

_HEADERS: Final = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
}


class PageServer:
    """Serves the page until `close`, each connection on a thread of its own. port 0: a free one, then in `port`.

    Errors: ConfigError for an address or a port that cannot be used.
    """

    def __init__(self, shown: Shown, changes: Changes, access: Access, bind: str, port: int) -> None:
        self._shown = shown

        class Handler(_Handler):
            pass

        Handler.shown, Handler.changes, Handler.access = shown, changes, access
        try:
            self._server = _Server((bind, port), Handler)
        except OSError as error:
            raise ConfigError(
                f"the page cannot be served on {bind}:{port}: {error.strerror}; choose another port or address"
            ) from error
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(CLOSING_S,), name="page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """The page is gone. May be called again."""
        self._shown.close()
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
            self._server.server_close()
            self._server.hang_up()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    # A burst is accepted in its order, also on a loaded gateway.
    request_queue_size = MOST_CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self.address_family = AF_INET6 if ":" in address[0] else AF_INET
        self._lock = threading.Lock()
        self._open: dict[socket, str] = {}
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """A connection too many is closed at once."""
        client = str(client_address[0])
        with self._lock:
            of_one = sum(other == client for other in self._open.values())
            is_room = len(self._open) < MOST_CONNECTIONS and of_one < MOST_OF_ONE
            if is_room:
                self._open[request] = client
        if is_room:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        """The end of a connection."""
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def hang_up(self) -> None:
        """End every connection: a browser keeps one open for its next request."""
        with self._lock:
            left = list(self._open)
        for one in left:
            with suppress(OSError):
                one.shutdown(SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing: a browser that goes away in the middle is no fault."""


class _Handler(BaseHTTPRequestHandler):
    shown: ClassVar[Shown]
    changes: ClassVar[Changes]
    access: ClassVar[Access]
    timeout = REQUEST_S
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "gelgate", ""
    connection: socket

    def do_GET(self) -> None:
        if self._is_refused():
            return
        path, query = urlsplit(self.path).path, urlsplit(self.path).query
        part = path.removeprefix("/").removesuffix(".json")
        if path in _FILES:
            name, content_type = _FILES[path]
            self._answer(200, content_type, files("edge.page.files").joinpath(name).read_bytes())
        elif path == "/live.json":
            self._news(query)
        elif path == "/station.json":
            self._json(self._station())
        elif path == "/presses.json":
            self._json(self.shown.presses())
        elif path == f"/{part}.json" and part in _PARTS:
            self._json(self.shown.station()[part])
        else:
            self._picture(path)

    def do_POST(self) -> None:
        if self._is_refused():
            return
        verb = urlsplit(self.path).path.removeprefix("/requests/")
        if not is_verb(verb):
            self.close_connection = True
            self._say(404, "there is no such page")
            return
        headers = {name.lower(): value for name, value in self.headers.items()}
        refused = self.changes.refusal(str(self.client_address[0]), headers)
        payload = self._body()
        if refused is None:
            self._answer(200, "application/json", self.changes.do(verb, payload))
        else:
            self._answer(refused.status, "application/json", self.changes.refuse(verb, payload, refused))

    def _is_refused(self) -> bool:
        reached = str(self.connection.getsockname()[0])
        client, host = str(self.client_address[0]), self.headers.get("Host", "")
        refused = self.access.refusal(client, reached, host)
        if refused is not None:
            self.close_connection = True
            self._say(refused.status, refused.sentence)
        return refused is not None

    def _body(self) -> bytes:
        """What was sent, as far as its length can be believed. Otherwise the connection ends with the answer."""
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > READ_OF_TOO_LARGE:
            self.close_connection = True
            return b""
        return self.rfile.read(int(length))

    def _news(self, query: str) -> None:
        after = parse_qs(query).get("after", [""])[0]
        if after.isascii() and after.isdigit():
            self.shown.wait(int(after[:12]), NEWS_S)
        self._json({**self._station(), "presses": self.shown.presses()})

    def _station(self) -> dict[str, Any]:
        return {**self.shown.station(), "changes": self.changes.described()}

    def _picture(self, path: str) -> None:
        press_id = path.removeprefix("/pictures/").removesuffix(".png")
        picture = self.shown.picture(press_id) if path == f"/pictures/{press_id}.png" else None
        if picture is None:
            self._say(404, "there is no such page")
        else:
            self._answer(200, "image/png", picture)

    def _json(self, content: object) -> None:
        self._answer(200, "application/json", json.dumps(content).encode())

    def _say(self, status: int, sentence: str) -> None:
        self._answer(status, _TEXT, f"{sentence}\n".encode())

    def _answer(self, status: int, content_type: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(content)))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """As text: what is refused before it is read, such as another method."""
        self.close_connection = True
        self._say(code, message or "this request is not understood")

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: a page that is open asks all the time."""
