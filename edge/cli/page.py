"""`gelgate station page`: the page of a station on another machine, such as a tablet or a PC in the office."""

import threading
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from edge.clock import SystemClock
from edge.config.loading import read_secret
from edge.core.errors import ConfigError
from edge.core.sentence import Sentence
from edge.core.sink_context import PageRequests
from edge.logs import start
from edge.messaging.command_payloads import SHORTEST_SECRET
from edge.messaging.subscriber import broker_at, station_filter
from edge.page.from_broker import BrokerStation, page_requests
from edge.page.server import PageServer
from edge.page.settings import PageSettings
from edge.validation_messages import numbered, sentences

__all__ = ["page"]


def page(
    host: Annotated[str, typer.Option(help="The broker's name or address.")] = "localhost",
    port: Annotated[int, typer.Option(help="Its port.", min=1, max=65535)] = 1883,
    prefix: Annotated[str, typer.Option(help="First level of the topics.")] = "gelgate",
    site: Annotated[str, typer.Option(help="The station's site; + for any.")] = "+",
    line: Annotated[str, typer.Option(help="Its line; + for any.")] = "+",
    station: Annotated[str, typer.Option(help="Its name; + for any.")] = "+",
    page_port: Annotated[int, typer.Option(help="The port of the page on this machine.")] = 8080,
    bind: Annotated[str, typer.Option(help="This machine's address for it; 0.0.0.0 for all.")] = "127.0.0.1",
    allow_from: Annotated[
        list[str] | None,
        typer.Option(help="Another machine or network that may see it; again for more. Needs --bind."),
    ] = None,
    name: Annotated[
        list[str] | None, typer.Option(help="A name of this machine in the address line; again for more.")
    ] = None,
    token_file: Annotated[
        Path | None, typer.Option(help="File that holds the token for changes. Needs --secret-file.")
    ] = None,
    secret_file: Annotated[
        Path | None,
        typer.Option(help="File that holds the station's secret, with which changes are signed."),
    ] = None,
    username: Annotated[str | None, typer.Option(help="User name for the broker.")] = None,
    password_file: Annotated[Path | None, typer.Option(help="File that holds the password.")] = None,
    ca: Annotated[
        Path | None, typer.Option(help="Use TLS and trust this certificate authority (PEM).")
    ] = None,
) -> None:
    """Serve the page of a station from a broker.

    It goes on until Ctrl-C, and says when the broker or the station is away. Without --secret-file it only shows."""
    given = {"bind": bind, "allow_from": allow_from or (), "names": name or (), "token_file": token_file}
    settings = _settings({"port": page_port, **given})
    broker = broker_at(host, port, "page", username, password_file, ca)
    shown = BrokerStation(broker, station_filter(prefix, site, line, station))
    requests = _requests(shown, settings, secret_file)
    why_not = Sentence("this page only shows: it was started without --secret-file and --token-file")
    server = PageServer(shown.shown, settings, requests, SystemClock(), why_not)
    start("text", is_verbose=False)
    try:
        shown.start()
        at = f"[{settings.bind}]" if ":" in settings.bind else settings.bind
        typer.echo(f"gelgate: the page is at http://{at}:{server.port}/", err=True)
        for warning in settings.warnings():
            typer.echo(f"gelgate: {warning}", err=True)
        threading.Event().wait()
    finally:
        server.close()
        shown.close()


def _settings(given: dict[str, object]) -> PageSettings:
    """Check the options. Errors: ConfigError with every fault."""
    try:
        return PageSettings.model_validate(given)
    except ValidationError as error:
        raise ConfigError(numbered("the page's options", sentences(PageSettings, error))) from error


def _requests(shown: BrokerStation, settings: PageSettings, secret_file: Path | None) -> PageRequests | None:
    """Make what asks the station for changes. Errors: ConfigError for a secret or a token alone."""
    if (settings.token() is None) != (secret_file is None):
        raise ConfigError(
            "changes need --secret-file, which signs them for the station, and --token-file, which a person types; "
            "give both, or neither"
        )
    if secret_file is None:
        return None
    return page_requests(shown, read_secret(secret_file, "--secret-file", SHORTEST_SECRET), SystemClock())
