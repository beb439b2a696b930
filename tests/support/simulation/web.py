"""A browser that asks all the time: the real page and its requests, over a wire in memory and without its threads."""

import io
import json
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from edge.core.sink_context import PageRequests, Station
from edge.page.changes import Changes
from edge.page.server import _Handler
from edge.page.settings import PageSettings
from plugins.sinks.page import PageSink
from simulation.connections import Connections

if TYPE_CHECKING:
    from simulation.schedule import Simulation

S = 10**9
TOKEN = "a token of the page"
PAGE = '[[sinks]]\nplugin = "simulated_page"\noptions = {{ token_file = "{file}" }}\n'
GUESSES = {
    "without a token": {"Content-Type": "application/json"},
    "with a wrong token": {"Content-Type": "application/json", "Authorization": "Bearer guessed here"},
    "of another page": {
        "Content-Type": "application/json",
        "Authorization": f"Bearer {TOKEN}",
        "Origin": "http://elsewhere.example",
    },
    "as a form": {"Content-Type": "text/plain", "Authorization": f"Bearer {TOKEN}"},
}
"""Requests that must change nothing (docs/security.md, The page)."""


class Wire:
    """The connection of one request, as a handler uses it."""

    def __init__(self, request: bytes) -> None:
        self._request, self.answer = request, b""

    def makefile(self, *_: object) -> io.BytesIO:
        return io.BytesIO(self._request)

    def sendall(self, data: bytes) -> None:
        self.answer += bytes(data)

    def getsockname(self) -> tuple[str, int]:
        return "127.0.0.1", 8080

    def settimeout(self, seconds: float) -> None:
        """Nothing is waited for."""

    def note(self, connection: object, *, is_answered: bool) -> None:
        """The server hears of it."""


class SteppedPage(PageSink):
    """The page, whose server is not started."""

    now: ClassVar["SteppedPage | None"] = None
    """That of the life that is on."""

    def _serve(self) -> None:
        shown, settings, station, clock = self._open.args

        class Handler(_Handler):
            pass

        Handler.shown, Handler.access, Handler.manual = shown, settings.access(), settings.manual
        Handler.changes = Changes(station, settings.token(), clock)
        self._handler, self.faults = Handler, ()

    @property
    def version(self) -> int:
        """Rises with every change."""
        return int(self._shown.station()["version"])

    def ask(
        self, method: str, path: str, headers: dict[str, str], body: bytes = b""
    ) -> tuple[int, str, bytes]:
        """Answer one request: its status, type and content."""
        lines = {"Host": "localhost", **({"Content-Length": str(len(body))} if body else {}), **headers}
        head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        wire = Wire(f"{method} {path} HTTP/1.1\r\n{head}Connection: close\r\n\r\n".encode() + body)
        self._handler(wire, ("127.0.0.1", 50000), wire)  # type: ignore[arg-type]
        said, _, content = wire.answer.partition(b"\r\n\r\n")
        first, *others = said.decode().split("\r\n")
        kind = next(line.partition(": ")[2] for line in others if line.startswith("Content-Type"))
        return int(first.split()[1]), kind, content


class PagePlugin:
    """The page of the run."""

    Options = PageSettings

    def open(self, options: PageSettings, station: Station) -> SteppedPage:
        now, page = Connections.now, station.page
        assert page is not None
        asked = PageRequests(
            page.verbs, lambda verb, payload: now.answer(page.do, verb, payload), page.refuse
        )
        sink = SteppedPage.now = SteppedPage(options, replace(station, page=asked), now.clock)
        for message in station.birth():
            sink.send(message)
        return sink


page_plugin = PagePlugin()


@dataclass
class View:
    """What a browser shows, and since when."""

    at_ns: int
    state: str
    press_id: str | None
    """Of the large verdict; None for no press yet."""
    word: str
    """The large verdict; a pass of one place of a piece is none."""


def large(shown: dict[str, Any]) -> tuple[str | None, str]:
    """Return the press and the word of the large verdict, as page.js has it."""
    last = next((press for press in shown["presses"] if not press.get("is_earlier")), None)
    if last is None:
        return None, ""
    word, piece = last["verdict"] or "error", shown["piece"]
    if word == "pass" and piece:
        is_over = piece["piece_id"] is None and piece["last_id"] is not None
        word = str(piece["last_verdict"]) if is_over and piece["last_id"] == last.get("piece_id") else "place"
    elif word == "pass" and last.get("place"):
        word = "place"
    state = (shown["state"] or {}).get("state")
    return last["press_id"], word if word != "pass" or state == "ready" else str(state)


class Browser:
    """It asks for what is new, for pictures, and for changes, right and wrong."""

    def __init__(self, run: "Simulation", rng: random.Random) -> None:
        self._run, self._rng, self._version, self._asked = run, rng, 0, 0
        self.view: View | None = None
        """What it shows; None where nobody answers."""
        self.refused: dict[str, str] = {}
        """Transactions of requests that must not be done, and why."""

    def act(self) -> float:
        """Ask once."""
        page, station = SteppedPage.now, self._run.station
        if page is None or station.is_frozen or station.shared.is_store_held:
            self.view = self.view if station.is_frozen else None
            return 0.3
        kind = self._rng.choice(("news", "news", "news", "news", "picture", "file", "guess", "request"))
        found = list(getattr(self, f"_{kind}")(page))
        self._run.run.faults += [f"the page: {what}" for what in found]
        return 0.1 + 0.4 * self._rng.random()

    def _news(self, page: SteppedPage) -> Iterator[str]:
        after = (
            f"?after={self._version}" if self._version != page.version else ""
        )  # which is answered at once
        status, kind, content = page.ask("GET", f"/live.json{after}", {})
        if (status, kind) != (200, "application/json"):
            yield f"what is new is answered by {status}, {kind}"
            return
        shown = json.loads(content)
        self._version = shown["version"]
        state = (shown["state"] or {}).get("state", "")
        self.view = View(self._run.world.clock.now_ns, state, *large(shown))

    def _picture(self, page: SteppedPage) -> Iterator[str]:
        """A picture that cannot be drawn any more is told of no longer."""
        newest = (self._list_pictured(page)[:1] or [""])[0]
        for press_id, expected in (newest, 200), ("0" * 26, 404), ("../page.token", 404):
            status, kind, _ = page.ask("GET", f"/pictures/{press_id}", {})
            is_told = press_id != newest or newest in self._list_pictured(page)
            if press_id and status != expected and is_told:
                yield f"the picture of {press_id} is answered by {status}, {kind}"

    @staticmethod
    def _list_pictured(page: SteppedPage) -> list[str]:
        presses = json.loads(page.ask("GET", "/presses.json", {})[2])
        return [press["press_id"] for press in presses if press["has_picture"]]

    def _file(self, page: SteppedPage) -> Iterator[str]:
        path = self._rng.choice(
            ("/", "/page.js", "/page.css", "/words/de.json", "/station.json", "/alarms.json")
        )
        if (status := page.ask("GET", path, {})[0]) != 200:
            yield f"{path} is answered by {status}"

    def _guess(self, page: SteppedPage) -> Iterator[str]:
        self._asked += 1
        kind, transaction = self._rng.choice(sorted(GUESSES)), f"page {self._asked}"
        self.refused[transaction] = kind
        body = json.dumps({"transaction": transaction, "arguments": {}}).encode()
        status, _, content = page.ask("POST", "/requests/replace_gel", GUESSES[kind], body)
        if status == 200 or json.loads(content)["status"] == "ok":
            yield f"a request {kind} is answered by {status}"
        self._run.reach(f"the page was asked {kind}")

    def _request(self, page: SteppedPage) -> Iterator[str]:
        self._asked += 1
        transaction = f"page {self._asked}"
        self._run.station.signed.add(transaction)
        headers = {"Content-Type": "application/json", "Authorization": f"Bearer {TOKEN}"}
        body = json.dumps({"transaction": transaction, "arguments": {"alarm": "pulse"}}).encode()
        status, _, content = page.ask("POST", "/requests/acknowledge_alarm", headers, body)
        if status not in (200, 429):
            yield f"a request with its token is answered by {status}: {content[:80]!r}"
        self._run.reach("the page was asked with its token")
