"""`gelgate station describe`: a station, as AsyncAPI, Home Assistant, Node-RED, mosquitto and CycloneDX read it."""

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from edge.cli.bill_of_materials import bill_of_materials
from edge.cli.options import CONFIG, ConfigOption
from edge.config import Config, load_config
from edge.core.errors import ConfigError
from edge.core.printable import printable
from edge.gateway.command_table import describe_station
from edge.gateway.opening import bundle_tables
from edge.messaging.descriptions.access_rules import access_rules
from edge.messaging.descriptions.asyncapi import document
from edge.messaging.descriptions.dashboards import discovery, flow
from edge.messaging.descriptions.station import DescribedStation, SparkplugNode
from edge.messaging.mqtt_broker import Broker
from edge.messaging.subscriber import broker_at, listening, next_message, station_filter

__all__ = ["Format", "describe", "describe_config", "station_at", "text_at"]

# From the subscription on. Retained messages come at once; those of a broker far away take longer.
WAIT_S: Final = 2.0

_SHOWN: Final = 8


class Format(StrEnum):
    """What is printed."""

    ASYNCAPI = "asyncapi"
    HOME_ASSISTANT = "homeassistant"
    NODE_RED = "node-red"
    MOSQUITTO = "mosquitto"
    CYCLONEDX = "cyclonedx"


def describe(
    config: ConfigOption = CONFIG,
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            metavar="|".join(Format),
            help="asyncapi: topics and schemas; homeassistant: its discovery message; node-red: a flow to import; "
            "mosquitto: access rules; cyclonedx: a bill of materials.",
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
    if host is None:
        text = describe_config(load_config(config), form)
    else:
        broker = broker_at(host, port, "describe", username, password_file, ca)
        text = text_at(broker, station_filter(prefix, site, line, station), form)
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")


def text_at(broker: Broker, topic_filter: str, form: Format) -> str:
    """The file, from a broker. Errors: ConfigError, SinkUnavailable."""
    if form is Format.MOSQUITTO:
        raise ConfigError(
            "access rules name the users of the broker, which it does not publish; give the station's --config"
        )
    if form is Format.CYCLONEDX:
        raise ConfigError(
            "what is installed on a station is not published; run it there, with the station's --config"
        )
    station, document = station_at(broker, topic_filter)
    return _text(form, station, document, broker.host, broker.port, broker.tls is not None)


def describe_config(config: Config, form: Format) -> str:
    """Write the file from a configuration, with the broker of its first `mqtt` sink, or the usual one of this machine.
    Errors: ConfigError; BundleError where a bill of materials has a bundle that cannot be read."""
    if form is Format.CYCLONEDX:
        return bill_of_materials([table.path for table in bundle_tables(config.inspection)])
    station = describe_station(config)
    broker = next((sink.options for sink in config.sinks if sink.plugin == "mqtt"), {})
    if form is Format.MOSQUITTO:
        nodes = (sink.options for sink in config.sinks if sink.plugin == "sparkplug")
        return access_rules(
            station,
            str(broker.get("username") or config.station.station),
            discovery_prefix=broker.get("home_assistant"),
            node=next(
                (SparkplugNode.of(station.root, node.get("group"), node.get("node")) for node in nodes), None
            ),
        )
    has_tls = broker.get("tls") is not None
    port = int(broker.get("port") or (8883 if has_tls else 1883))
    return _text(form, station, document(station), str(broker.get("host", "localhost")), port, has_tls)


def _text(
    form: Format, station: DescribedStation, document: object, host: str, port: int, has_tls: bool
) -> str:
    if form is Format.HOME_ASSISTANT:
        document = discovery(station)
        if not station.keeps_heatmap:
            typer.echo(
                f"gelgate: {printable(station.place)} retains no picture, so Home Assistant shows none: set "
                "station.last_heatmap = true, or home_assistant in the options of its mqtt sink",
                err=True,
            )
    elif form is Format.NODE_RED:
        document = flow(station, host, port, has_tls=has_tls)
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def station_at(broker: Broker, topic_filter: str) -> tuple[DescribedStation, Mapping[str, Any]]:
    """Find the one station with these topics, and its AsyncAPI document.

    topic_filter: as of `station_filter`. Errors: SinkUnavailable without a broker; ConfigError where no station
    describes itself there, or several do.
    """
    documents: dict[str, Mapping[str, Any]] = {}
    with listening(broker, topic_filter.removesuffix("#") + "asyncapi") as (_, inbox):
        end = time.monotonic() + WAIT_S
        while (message := next_message(inbox, max(0.0, end - time.monotonic()))) is not None:
            try:
                content = json.loads(message.payload)
            except (ValueError, RecursionError):  # anybody may publish
                continue
            if isinstance(content, dict) and "asyncapi" in content:
                documents[message.topic.removesuffix("/asyncapi")] = content
    if len(documents) != 1:
        raise ConfigError(_not_one(broker, topic_filter, sorted(documents)))
    ((root, document),) = documents.items()
    info = document.get("info")
    version = info.get("version") if isinstance(info, dict) else None
    keeps_heatmap, picture_type = _pictures(document)
    described = replace(DescribedStation.of_root(root), version=str(version))
    return replace(described, keeps_heatmap=keeps_heatmap, picture_type=picture_type), document


def _pictures(document: Mapping[str, Any]) -> tuple[bool, str]:
    """Read whether the station retains its newest picture, and the content type of its pictures. Anybody may publish:
    what cannot be read is as by default."""
    try:
        is_retained = "last_heatmap_picture" in document["channels"]["last_heatmap"]["messages"]
        is_png = document["components"]["messages"]["heatmap_picture"]["contentType"] == "image/png"
    except (KeyError, TypeError):
        return False, "image/jpeg"
    return is_retained, "image/png" if is_png else "image/jpeg"


def _not_one(broker: Broker, topic_filter: str, roots: list[str]) -> str:
    if not roots:
        return (
            f"broker {broker} has no station that describes itself below {topic_filter}; check the names, and that its "
            "gateway has run with this broker"
        )
    places = ", ".join(printable("/".join(root.split("/")[1:-2])) for root in roots[:_SHOWN])
    more = f" and {len(roots) - _SHOWN} more" if len(roots) > _SHOWN else ""
    return f"broker {broker} has several stations: {places}{more}; name one with --site, --line and --station"
