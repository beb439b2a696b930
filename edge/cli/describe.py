"""`gelgate describe`: a station for other programs, as AsyncAPI, Home Assistant, Node-RED and mosquitto read it."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from edge.config import Config

__all__ = ["Format", "describe"]


class Format(StrEnum):
    """What is printed."""

    ASYNCAPI = "asyncapi"
    HOME_ASSISTANT = "homeassistant"
    NODE_RED = "node-red"
    MOSQUITTO = "mosquitto"


def describe(
    config: Annotated[Path, typer.Option("--config", "-c", help="The station's TOML file.")] = Path(
        "gelgate.toml"
    ),
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            metavar="|".join(Format),
            help="asyncapi: topics and schemas; homeassistant: its discovery message; node-red: a flow to import; "
            "mosquitto: access rules.",
        ),
    ] = Format.ASYNCAPI,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write this file instead.")] = None,
) -> None:
    """Describe a station to other programs.

    It reads the configuration alone: neither sensor nor broker is needed. docs/subscribers.md says what to do with each
    format."""
    from edge.config import load_config

    text = described_text(load_config(config), form)
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")


def described_text(config: "Config", form: Format) -> str:
    """The file. Errors: ConfigError."""
    import json

    from edge.gateway.description import broker_of, described
    from edge.messaging.descriptions.access_rules import access_rules
    from edge.messaging.descriptions.asyncapi import document
    from edge.messaging.descriptions.home_assistant import discovery
    from edge.messaging.descriptions.node_red import flow

    station, broker = described(config), broker_of(config)
    if form is Format.MOSQUITTO:
        return access_rules(station, broker.user, discovery_prefix=broker.discovery_prefix, node=broker.node)
    made: object = document(station)
    if form is Format.HOME_ASSISTANT:
        made = discovery(station)
    elif form is Format.NODE_RED:
        made = flow(station, broker.host, broker.port, has_tls=broker.has_tls)
    return json.dumps(made, indent=2, ensure_ascii=False) + "\n"
