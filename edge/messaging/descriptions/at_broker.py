"""A station as it describes itself at a broker: all that is needed is the broker's address."""

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from edge.core.errors import ConfigError
from edge.core.printable import printable
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.mqtt_broker import Broker
from edge.messaging.subscriber import listening, next_message

__all__ = ["station_at"]

# From the subscription on. Retained messages come at once; those of a broker far away take longer.
WAIT_S: Final = 2.0

_SHOWN: Final = 8


def station_at(
    broker: Broker, topic_filter: str, wait_s: float = WAIT_S
) -> tuple[DescribedStation, Mapping[str, Any]]:
    """The one station with these topics, and its AsyncAPI document.

    topic_filter: as of `station_filter`. Errors: SinkUnavailable without a broker; ConfigError where no station
    describes itself there, or several do.
    """
    documents: dict[str, Mapping[str, Any]] = {}
    with listening(broker, topic_filter.removesuffix("#") + "asyncapi") as (_, inbox):
        end = time.monotonic() + wait_s
        while (message := next_message(inbox, max(0.0, end - time.monotonic()))) is not None:
            if (document := _document(message.payload)) is not None:
                documents[message.topic.removesuffix("/asyncapi")] = document
    if len(documents) != 1:
        raise ConfigError(_not_one(broker, topic_filter, sorted(documents)))
    root, document = documents.popitem()
    info = document.get("info")
    version = info.get("version") if isinstance(info, dict) else None
    return replace(DescribedStation.of_root(root), version=str(version)), document


def _document(payload: bytes) -> Mapping[str, Any] | None:
    """Parse an AsyncAPI document; None for anything else, as anybody may publish."""
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and "asyncapi" in content else None


def _not_one(broker: Broker, topic_filter: str, roots: list[str]) -> str:
    if not roots:
        return (
            f"broker {broker} has no station that describes itself below {topic_filter}; check the names, and that its "
            "gateway has run with this broker"
        )
    places = ", ".join(printable("/".join(root.split("/")[1:-2])) for root in roots[:_SHOWN])
    more = f" and {len(roots) - _SHOWN} more" if len(roots) > _SHOWN else ""
    return f"broker {broker} has several stations: {places}{more}; name one with --site, --line and --station"
