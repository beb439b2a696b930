"""A station on the dashboards of others: as a device of Home Assistant, and as a page of Node-RED.

Home Assistant reads a discovery message, which names topics and nothing else; it can ask the station for nothing. The
station is available by `state`, not by `availability`: a broker may not allow the second connection that this needs.
Ref: home-assistant.io, MQTT integration, "Device discovery payload" (since 2024.12).

The flow is made of the nodes that every Node-RED has. Imported (menu, Import) and deployed, it shows verdict, picture,
gel and state at `/gelgate/` of the Node-RED server.
Ref: nodered.org, "Storing flows"; mqtt in, template and http nodes of Node-RED 3 to 5.
"""

import hashlib
import html
import json
from collections.abc import Callable
from importlib import resources
from string import Template
from typing import Any, Final
from urllib.parse import quote

from edge.messaging.descriptions.station import DescribedStation

__all__ = ["PAGE", "discovery", "discovery_topic", "flow"]

PAGE: Final = "/gelgate/{place}"
"""The path of the page at the Node-RED server."""


def flow(
    station: DescribedStation, host: str = "localhost", port: int = 1883, *, has_tls: bool = False
) -> list[dict[str, Any]]:
    """The nodes of the flow, plain JSON to import. host, port, has_tls: of the broker; user, password and certificates
    are set in Node-RED."""
    values = {
        "host": host,
        "page": PAGE.format(place=quote(station.place)),
        "place": station.place,
        "port": port,
        "root": station.root,
        "title": html.escape(station.place),
    }

    def fill(text: str) -> str:
        """Put the values in; `@name` is the id of a node, the same at every export."""
        if text.startswith("@"):
            return hashlib.sha256(f"{station.id}/{text[1:]}".encode()).hexdigest()[:16]
        return Template(text).substitute(values)

    nodes: list[dict[str, Any]] = _read_template("node_red.json", fill)
    for node in nodes:
        if node["type"] == "mqtt-broker":
            node["usetls"] = has_tls
    return nodes


def discovery_topic(station: DescribedStation, prefix: str) -> str:
    """The topic on which the message is retained; an empty message there removes the device."""
    return f"{prefix}/device/{station.id}/config"


def discovery(station: DescribedStation) -> dict[str, Any]:
    """The message, plain JSON. It has a picture where the station retains one."""
    values = {name: getattr(station, name) for name in ("id", "place", "root", "version", "picture_type")}
    message: dict[str, Any] = _read_template(
        "home_assistant.json", lambda text: Template(text).substitute(values)
    )
    if not station.keeps_heatmap:
        del message["components"]["picture"]
    return message


def _read_template(name: str, fill: Callable[[str], str]) -> Any:
    """Read a JSON file of this folder, with each of its texts filled in."""

    def walk(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: walk(item) for key, item in value.items()}
        if isinstance(value, list):
            return [walk(item) for item in value]
        return fill(value) if isinstance(value, str) else value

    text = resources.files("edge.messaging.descriptions").joinpath(name).read_text(encoding="utf-8")
    return walk(json.loads(text))
