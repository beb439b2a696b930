"""The manual as a site, which `gelgate station docs --site` makes: files of one folder, and nothing else."""

import base64
import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import unquote, urlsplit

from edge.core.errors import ConfigError
from edge.core.ports import Clock
from edge.page.access import Access
from edge.page.http_server import TEXT, HttpHandler, HttpServer

__all__ = ["ManualFile", "find_file", "serve_manual"]

_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".xml": "application/xml",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".webp": "image/webp",
    ".woff2": "font/woff2",
}

_SCRIPT: Final = re.compile(rb"<script>(.*?)</script>", re.DOTALL)


class ManualFile(NamedTuple):
    """A file of the manual, and what a browser may do with it."""

    content_type: str
    content: bytes
    policy: str
    """The scripts of a page are known by their hashes; no other runs, and nothing is loaded from elsewhere."""


def find_file(folder: Path, path: str) -> ManualFile | None:
    """Return the file at a path such as `docs/mqtt.html`; None where there is none in the folder."""
    root = folder.resolve()
    try:
        file_path = (root / (unquote(path) or "index.html")).resolve()
        if not file_path.is_relative_to(root) or not file_path.is_file():
            return None
        content = file_path.read_bytes()
    except (OSError, ValueError):  # such as a NUL in it, or a name that is too long
        return None
    kind = _TYPES.get(file_path.suffix, TEXT)
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(script).digest()).decode()}'"
        for script in _SCRIPT.findall(content if file_path.suffix == ".html" else b"")
    )
    policy = (
        f"default-src 'self'; script-src 'self' {hashes}; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return ManualFile(kind, content, policy)


@contextmanager
def serve_manual(folder: Path, port: int, clock: Clock) -> Iterator[HttpServer]:
    """Serve it to browsers on this machine. Errors: ConfigError for a port in use."""

    class Handler(HttpHandler):
        access = Access()

        def do_GET(self) -> None:
            manual_file = find_file(folder, urlsplit(self.path).path.removeprefix("/"))
            if manual_file is None:
                self.say(404, "there is no such page of the manual")
            else:
                self.answer(200, manual_file.content_type, manual_file.content, manual_file.policy)

    try:
        server = HttpServer(("127.0.0.1", port), Handler, clock, "manual")
    except OSError as error:
        raise ConfigError(
            f"the manual cannot be served at port {port}: {error.strerror}; name another with --port"
        ) from error
    server.start()
    try:
        yield server
    finally:
        server.close()
