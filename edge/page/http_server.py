"""An HTTP server for a few clients that do not trust each other: bounded in connections, and in the time of a request.

What two programs may read differently, such as a proxy and this one, is answered with 400, and the connection ends.

Ref: RFC 9112, section 6.3 and 11.2 (request smuggling).
"""

import logging
import re
import sys
import threading
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import AF_INET, AF_INET6, SHUT_RDWR, socket
from typing import Any, ClassVar, Final, NamedTuple

from edge.core.ports import Clock
from edge.page.access import Access, Refused

__all__ = ["MOST_OF_ONE", "REQUEST_S", "TEXT", "HttpHandler", "HttpServer"]

log = logging.getLogger(__name__)

# From the silence before a request to its last byte. An answer that is not read for this time ends the connection too.
REQUEST_S: Final = 10.0

# Connections at once, and those of one address; a browser opens up to six.
MOST_CONNECTIONS: Final = 64
MOST_OF_ONE: Final = 24

# The server looks this often whether it is closed, and whether a request takes too long.
LOOK_S: Final = 0.1

# Of a request that is too large this much is read before it is answered: a browser that is cut off shows no answer.
READ_OF_TOO_LARGE: Final = 1 << 20

TEXT: Final = "text/plain; charset=utf-8"

_LENGTH: Final = re.compile(r"[0-9]{1,40}")

_POLICY: Final = (
    "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class _Open(NamedTuple):
    """A connection. due_ns: its request must be here by then; None while it is answered."""

    client: str
    due_ns: int | None


class HttpServer(ThreadingHTTPServer):
    """Serves on a thread for each connection from `start` to `close`. Errors: OSError for an address in use."""

    daemon_threads = True
    block_on_close = False
    # A burst is accepted in its order, also on a loaded gateway.
    request_queue_size = MOST_CONNECTIONS

    def __init__(
        self,
        address: tuple[str, int],
        handler: type[BaseHTTPRequestHandler],
        clock: Clock,
        name: str = "page",
    ) -> None:
        self.address_family = AF_INET6 if ":" in address[0] else AF_INET
        self._clock = clock
        self._lock = threading.Lock()
        self._open: dict[socket, _Open] = {}
        self._thread = threading.Thread(target=self.serve_forever, args=(LOOK_S,), name=name, daemon=True)
        super().__init__(address, handler)

    def start(self) -> None:
        """Serve from now on."""
        self._thread.start()

    def close(self) -> None:
        """End it with every connection: a browser keeps one open for its next request. May be called again."""
        if self._thread.is_alive():
            self.shutdown()
            self._thread.join()
            self.server_close()
            with self._lock:
                for connection in list(self._open):
                    self._hang_up(connection)

    def process_request(self, request: Any, client_address: Any) -> None:
        """A connection too many takes the place of the one that has waited longest for its request. Where all are
        answered, it is closed at once."""
        client = str(client_address[0])
        with self._lock:
            has_place = self._make_place(client)
            if has_place:
                self._open[request] = _Open(client, self._due_ns())
        if has_place:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def _make_place(self, client: str) -> bool:
        of_one = [connection for connection, (other, _) in self._open.items() if other == client]
        rivals = of_one if len(of_one) >= MOST_OF_ONE else list(self._open)
        if rivals is not of_one and len(rivals) < MOST_CONNECTIONS:
            return True
        waiting = [
            (due_ns, n) for n, rival in enumerate(rivals) if (due_ns := self._open[rival].due_ns) is not None
        ]
        if waiting:
            self._hang_up(rivals[min(waiting)[1]])
        return bool(waiting)

    def note(self, connection: socket, *, is_answered: bool) -> None:
        """A connection is answered, or its next request is waited for."""
        with self._lock:
            opened = self._open.get(connection)
            if opened is not None and is_answered != (opened.due_ns is None):
                self._open[connection] = _Open(opened.client, None if is_answered else self._due_ns())

    def service_actions(self) -> None:
        """Hang up on requests that take too long."""
        now_ns = self._clock.monotonic_ns()
        with self._lock:
            for connection, (_, due_ns) in list(self._open.items()):
                if due_ns is not None and due_ns <= now_ns:
                    self._hang_up(connection)

    def _due_ns(self) -> int:
        return self._clock.monotonic_ns() + round(REQUEST_S * 1e9)

    def _hang_up(self, connection: socket) -> None:
        del self._open[connection]
        with suppress(OSError):
            connection.shutdown(SHUT_RDWR)

    def shutdown_request(self, request: Any) -> None:
        """End a connection."""
        with self._lock:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Have a fault of ours in the log; a browser that goes away in the middle is none."""
        if not isinstance(sys.exception(), OSError):
            log.exception("a request of %s is not answered; its connection is ended", client_address[0])


class HttpHandler(BaseHTTPRequestHandler):
    """One connection. `do_GET` and `do_POST` see whole requests alone, of whom `access` admits. body: of a POST."""

    access: ClassVar[Access]
    timeout = REQUEST_S
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "gelgate", ""
    connection: socket
    server: HttpServer
    body = b""

    def handle_one_request(self) -> None:
        self.server.note(self.connection, is_answered=False)
        super().handle_one_request()

    def parse_request(self) -> bool:
        """Tell whether there is a request to be served; otherwise answer it."""
        if not super().parse_request():
            return False
        reached, client = str(self.connection.getsockname()[0]), str(self.client_address[0])
        refused = self._malformation() or self.access.refusal(client, reached, self.headers.get("Host", ""))
        if refused is not None:
            self.close_connection = True
            self.say(refused.status, refused.sentence)
        elif self._has_read_body():
            self.server.note(self.connection, is_answered=True)
            return True
        return False

    def _malformation(self) -> Refused | None:
        lengths = self.headers.get_all("Content-Length", [])
        if not self.path.startswith("/"):
            return Refused(400, "a request names a path that begins with '/', without the name of a server")
        if (
            self.headers.defects
            or "Transfer-Encoding" in self.headers
            or len(self.headers.get_all("Host", [])) > 1
        ):
            return Refused(400, "the headers of this request can be read in two ways")
        if len(lengths) > 1 or not all(_LENGTH.fullmatch(length) for length in lengths):
            return Refused(400, "Content-Length is one whole number of bytes")
        if self.command != "POST" and any(map(int, lengths)):
            return Refused(400, f"a request with {self.command} has no body")
        return None

    def _has_read_body(self) -> bool:
        """Read the body; a part of a too large one is enough, and the connection ends with the answer."""
        length = int(self.headers.get("Content-Length", "0"))
        if length > READ_OF_TOO_LARGE:
            self.close_connection = True
            length = 0
        self.body = self.rfile.read(length)
        self.close_connection |= len(self.body) < length
        return len(self.body) == length

    def say(self, status: int, sentence: str) -> None:
        """Answer with one line of text."""
        self.answer(status, TEXT, f"{sentence}\n".encode())

    def answer(self, status: int, content_type: str, content: bytes, policy: str = _POLICY) -> None:
        """Answer with the headers that forbid what no page needs."""
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(content)))
        for name, value in {**_HEADERS, "Content-Security-Policy": policy}.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer with text what is refused before it is read, such as another method."""
        self.close_connection = True
        self.say(code, message or "this request is not understood")

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: a page that is open asks all the time."""
