"""The sink passes the checks of every sink. The receiver is a server that stops and starts on a port."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from edge.core.errors import SinkRejected
from edge.core.ports import Message
from edge.core.sink_context import Station
from plugins.conformance import check_sink

from .sink import Sink, SinkOptions, plugin

LARGEST = 100_000
"""Bytes that the server takes."""


class Receiver:
    """A bench: what the server has, and how it is taken away and brought back."""

    def __init__(self) -> None:
        self._posted: list[tuple[str, bytes]] = []
        self._server = self._listen(0)
        self._port = self._server.server_address[1]

    def _listen(self, port: int) -> ThreadingHTTPServer:
        posted = self._posted

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                payload = self.rfile.read(int(self.headers["Content-Length"]))
                if self.path.startswith("/moved/"):
                    self.send_response(301)
                    self.send_header("Location", self.path.removeprefix("/moved"))
                    self.end_headers()
                    return
                is_taken = len(payload) <= LARGEST
                if is_taken:
                    posted.append((self.path.removeprefix("/"), payload))
                self.send_response(204 if is_taken else 413)
                self.end_headers()

            def do_GET(self) -> None:
                self.send_response(204)
                self.end_headers()

            def log_message(self, *_: object) -> None: ...

        server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}).start()
        return server

    def open(self, station: Station, path: str = "") -> Sink:
        return plugin.open(SinkOptions(url=f"http://127.0.0.1:{self._port}{path}"), station)

    def received(self, n: int) -> Sequence[tuple[str, bytes]]:
        return self._posted[:n]

    def take_away(self) -> bool:
        self._server.shutdown()
        self._server.server_close()
        return True

    def bring_back(self) -> None:
        self._server = self._listen(self._port)

    def wait(self) -> None:
        """A retry needs no time."""

    def unwanted(self) -> Message:
        return Message("heatmap/1", bytes(LARGEST + 1), content_type="image/png")


@pytest.fixture
def closing() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_it_conforms(closing: ExitStack) -> None:
    """`check_sink` names every fact that does not hold."""

    def make() -> Receiver:
        receiver = Receiver()
        closing.callback(receiver.take_away)
        return receiver

    check_sink(make)


def test_a_url_that_leads_elsewhere_takes_nothing(closing: ExitStack) -> None:
    """Such as http to https: what is asked there has no message in it, so nothing is done."""
    receiver = Receiver()
    closing.callback(receiver.take_away)
    sink = receiver.open(Station("root", "station"), "/moved")
    with pytest.raises(SinkRejected, match="and nothing was posted; name that in `url`"):
        sink.send(Message("result", b"{}"))
