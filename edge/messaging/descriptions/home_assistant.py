"""A station as a device of Home Assistant: its MQTT discovery message, which names topics and nothing else.

Home Assistant only reads: it can ask the station for nothing. It is available by `state`, not by `availability`: a
broker may not allow the second connection that this needs.
Ref: home-assistant.io, MQTT integration, "Device discovery payload" (since 2024.12).
"""

from string import Template
from typing import Any, Final

from edge.messaging.descriptions.station import DescribedStation, read_template

__all__ = ["discovery", "discovery_topic"]

DISCOVERY_PREFIX: Final = "homeassistant"


def discovery_topic(station: DescribedStation, prefix: str = DISCOVERY_PREFIX) -> str:
    """The topic on which the message is retained; an empty message there removes the device."""
    return f"{prefix}/device/{station.id}/config"


def discovery(station: DescribedStation) -> dict[str, Any]:
    """The message, plain JSON."""
    values = {
        "id": station.id,
        "place": station.place,
        "root": station.root,
        "version": station.version,
    }
    message: dict[str, Any] = read_template(
        "home_assistant.json", lambda text: Template(text).substitute(values)
    )
    return message
