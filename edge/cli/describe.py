"""`gelgate station describe`: a station, as AsyncAPI, Home Assistant, Node-RED and mosquitto read it."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edge.cli.station_options import CONFIG, ConfigOption

if TYPE_CHECKING:
    from edge.config import Config
    from edge.messaging.mqtt_broker import Broker

__all__ = ["Format", "describe", "described_text", "text_at"]


class Format(StrEnum):
    """What is printed."""

    ASYNCAPI = "asyncapi"
    HOME_ASSISTANT = "homeassistant"
    NODE_RED = "node-red"
    MOSQUITTO = "mosquitto"


def describe(
    config: ConfigOption = CONFIG,
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
    host: Annotated[str | None, typer.Option(help="Read it from this broker instead of a TOML file.")] = None,
    port: Annotated[int, typer.Option(help="Its port.", min=1, max=65535)] = 1883,
    prefix: Annotated[str, typer.Option(help="First level of the topics.")] = "gelgate",
    site: Annotated[str, typer.Option(help="The station's site; + for any.")] = "+",
    line: Annotated[str, typer.Option(help="Its line; + for any.")] = "+",
    station: Annotated[str, typer.Option(help="Its name; + for any.")] = "+",
    username: Annotated[str | None, typer.Option(help="User name for the broker.")] = None,
    password_file: Annotated[Path | None, typer.Option(help="File that holds the password.")] = None,
    ca: Annotated[
        Path | None, typer.Option(help="Use TLS and trust this certificate authority (PEM).")
    ] = None,
) -> None:
    """Describe a station to other programs.

    It reads the configuration alone, or with --host what the station has left at its broker. docs/subscribers.md says
    what to do with each format."""
    from edge.cli.broker_options import broker_at
    from edge.config import load_config
    from edge.messaging.subscriber import station_filter

    if host is None:
        text = described_text(load_config(config), form)
    else:
        broker = broker_at(host, port, "describe", username, password_file, ca)
        text = text_at(broker, station_filter(prefix, site, line, station), form)
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")


def text_at(broker: "Broker", topic_filter: str, form: Format) -> str:
    """The file, from a broker. Errors: ConfigError, SinkUnavailable."""
    from edge.core.errors import ConfigError
    from edge.messaging.descriptions.at_broker import station_at
    from edge.messaging.descriptions.home_assistant import discovery
    from edge.messaging.descriptions.node_red import flow

    if form is Format.MOSQUITTO:
        raise ConfigError(
            "access rules name the users of the broker, which it does not publish; give the station's --config"
        )
    station, made = station_at(broker, topic_filter)
    if form is Format.HOME_ASSISTANT:
        return _json(discovery(station))
    if form is Format.NODE_RED:
        return _json(flow(station, broker.host, broker.port, has_tls=broker.tls is not None))
    return _json(made)


def described_text(config: "Config", form: Format) -> str:
    """The file, from a configuration. Errors: ConfigError."""
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
    return _json(made)


def _json(made: object) -> str:
    import json

    return json.dumps(made, indent=2, ensure_ascii=False) + "\n"
