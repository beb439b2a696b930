"""The page over HTTP: its files, what it shows as JSON, pictures, and requests of the people at it.

    /                            the page; one file each of HTML, CSS and JavaScript, and the words of a language
    /words/<language>.json       English text to the one of this language
    /live.json?after=<version>   everything that is shown; answered when there is another version, or after a while
    /station.json                all of these, alarms with what to do, and what may be changed
    /state.json, /info.json, /gel.json, /reference.json, /piece.json, /questions.json, /drift.json, /stats.json,
    /alarms.json                 one of them
    /presses.json                the newest results, newest first
    /manual/                     the manual, where the settings name its folder
    /pictures/<press id>         JPEG or PNG, as the station draws it
    POST /requests/<verb>        a request as on `cmd/<verb>`, with `Authorization: Bearer <token>`

A status other than 200 says that the request was not admitted; how an admitted one ended is in its answer.
"""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar, Final
from urllib.parse import parse_qs, urlsplit

from edge import registry
from edge.core.errors import ConfigError
from edge.core.ports import Clock
from edge.core.sink_context import PageRequests
from edge.page.changes import READ_ONLY, Changes, is_verb
from edge.page.http_server import HttpHandler, HttpServer
from edge.page.manual import find_file
from edge.page.settings import PageSettings
from edge.page.shown import Shown

__all__ = ["LANGUAGES", "PageServer"]

# A browser that waits for news is answered after this time without any; without an answer it says so 3 s later.
NEWS_S: Final = 5.0

_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}

# Besides English, which is that of the HTML and JavaScript; each is named in page.html too.
LANGUAGES: Final = ("de", "it", "ja")
_WORDS = {f"/words/{language}.json": language for language in LANGUAGES}

_PARTS: Final = ("state", "info", "gel", "reference", "piece", "questions", "drift", "stats", "alarms")


def read_words(language: str) -> dict[str, Any]:
    """Return the catalogue of a language, with the words of installed features of other packages, which change none of
    gelgate's. Errors: ConfigError for a feature that cannot be loaded."""
    words: dict[str, Any] = json.loads(
        files("edge.page.files").joinpath(f"words_{language}.json").read_bytes()
    )
    for name in registry.foreign("features"):
        theirs = getattr(registry.feature(name), "words", {}).get(language, {})
        words["sentences"] |= {
            text: said for text, said in theirs.items() if text not in {*words, *words["sentences"]}
        }
    return words


class PageServer:
    """Serves the page until `close`, each connection on a thread of its own.

    station: does what the people at the page ask for; None where nothing can be changed, and why_not says why to them.
    port: instead of the one of the settings; 0 for a free one. Errors: ConfigError for an address, a port or a token
    that cannot be used.
    """

    def __init__(
        self,
        shown: Shown,
        settings: PageSettings,
        station: PageRequests | None,
        clock: Clock,
        why_not: str = READ_ONLY,
        port: int | None = None,
    ) -> None:
        self._shown = shown
        bind, port = settings.bind, settings.port if port is None else port

        class Handler(_Handler):
            pass

        Handler.shown, Handler.access, Handler.manual = shown, settings.access(), settings.manual
        Handler.changes = Changes(station, settings.token(), clock, why_not)
        try:
            self._server = HttpServer((bind, port), Handler, clock)
        except OSError as error:
            raise ConfigError(
                f"the page cannot be served on {bind}:{port}: {error.strerror}; choose another port or address"
            ) from error
        self.port = int(self._server.server_address[1])
        self._server.start()

    def close(self) -> None:
        """The page is gone. May be called again."""
        self._shown.close()
        self._server.close()


class _Handler(HttpHandler):
    shown: ClassVar[Shown]
    changes: ClassVar[Changes]
    manual: ClassVar[Path | None]

    def do_GET(self) -> None:
        path, query = urlsplit(self.path).path, urlsplit(self.path).query
        part = path.removeprefix("/").removesuffix(".json")
        if path in _WORDS:
            self._json(read_words(_WORDS[path]))
        elif path in _FILES:
            name, content_type = _FILES[path]
            self.answer(200, content_type, files("edge.page.files").joinpath(name).read_bytes())
        elif path == "/live.json":
            self._news(query)
        elif path == "/station.json":
            self._json(self._station())
        elif path == "/presses.json":
            self._json(self.shown.presses())
        elif path == f"/{part}.json" and part in _PARTS:
            self._json(self.shown.station()[part])
        elif path.startswith("/manual/"):
            self._manual(path.removeprefix("/manual/"))
        else:
            self._picture(path)

    def do_POST(self) -> None:
        verb = urlsplit(self.path).path.removeprefix("/requests/")
        if not is_verb(verb):
            self.close_connection = True
            self.say(404, "there is no such page")
            return
        headers = {name.lower(): value for name, value in self.headers.items()}
        refused = self.changes.refusal(str(self.client_address[0]), headers)
        if refused is None:
            self.answer(200, "application/json", self.changes.do(verb, self.body))
        else:
            self.answer(refused.status, "application/json", self.changes.refuse(verb, self.body, refused))

    def _news(self, query: str) -> None:
        after = parse_qs(query).get("after", [""])[0]
        if after.isascii() and after.isdigit():
            self.shown.wait(int(after[:12]), NEWS_S)
        self._json({**self._station(), "presses": self.shown.presses()})

    def _station(self) -> dict[str, Any]:
        has_manual = self.manual is not None and (self.manual / "index.html").is_file()
        return {**self.shown.station(), "changes": self.changes.offer(), "has_manual": has_manual}

    def _manual(self, path: str) -> None:
        manual_file = None if self.manual is None else find_file(self.manual, path)
        if manual_file is None:
            self.say(404, "there is no such page")
        else:
            self.answer(200, manual_file.content_type, manual_file.content, manual_file.policy)

    def _picture(self, path: str) -> None:
        press_id = path.removeprefix("/pictures/")
        picture = self.shown.picture(press_id) if path == f"/pictures/{press_id}" else None
        if picture is None:
            self.say(404, "there is no such page")
        else:
            self.answer(200, picture.content_type, picture.data)

    def _json(self, content: object) -> None:
        self.answer(200, "application/json", json.dumps(content).encode())
