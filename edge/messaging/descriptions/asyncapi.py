"""The AsyncAPI 3 document of a station: every topic, its delivery, and the schema of its payload.

It is retained on the station's topic `asyncapi`, so that the broker's address is enough to know everything.
Ref: AsyncAPI 3.0.0, MQTT bindings 0.2.0 (asyncapi.com).
"""

import json
import re
from collections.abc import Mapping
from functools import cache, partial
from typing import Any, Final

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from edge.core.ports import Message
from edge.messaging.alarm_payload import list_alarms
from edge.messaging.command_payloads import CommandRequest, CommandResponse
from edge.messaging.descriptions.station import DescribedCommand, DescribedStation
from edge.messaging.topics import TOPICS, Topic

__all__ = ["asyncapi_message", "document"]

REFERENCE: Final = "#/components/schemas/{model}"

_CLOSED: Final = ("additionalProperties", False)

_BINARY: Final = {"type": "string", "format": "binary"}

_CONTENT: Final = {
    "PNG": ("image/png", _BINARY),
    "JPEG": ("image/jpeg", _BINARY),
    "text": ("text/plain", {"enum": ["online", "offline"]}),
    "AsyncAPI": ("application/json", {"type": "object", "required": ["asyncapi", "channels"]}),
}


def _parameter(name: str) -> dict[str, Any]:
    if name == "alarm":
        return {"description": "the alarm's id", "enum": list(list_alarms())}
    return {"description": "the `press_id` of the result, a ULID"}


_ABOUT: Final = """\
Verdicts of a touch inspection station. Within `{version}` fields may be added: ignore those that you do not know.
A result may arrive twice, with the same `press_id`. An empty payload on a retained topic means "nothing here"."""


def asyncapi_message(station: DescribedStation) -> Message:
    """The document, retained."""
    text = json.dumps(document(station), separators=(",", ":"), ensure_ascii=False)
    return Message("asyncapi", text.encode(), qos=1, retain=True)


def document(station: DescribedStation) -> dict[str, Any]:
    """Plain JSON that meets the published schema of AsyncAPI 3.0.0."""
    published = [topic for topic in TOPICS if not topic.name.startswith("cmd/")]
    models = dict.fromkeys(topic.payload for topic in published if not isinstance(topic.payload, str))
    schemas = payload_schemas((*models, CommandResponse))
    arguments = {_request_name(command): command.arguments for command in station.commands}
    requests = {name: request_schema(CommandRequest, model) for name, model in arguments.items()}
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": f"gelgate station {station.place}",
            "version": station.version,
            "description": _ABOUT.format(version=station.root.rpartition("/")[2]),
        },
        "defaultContentType": "application/json",
        "channels": {
            **{_key(topic): _channel(station, topic) for topic in published},
            **{f"cmd_{command.verb}": _request_channel(station, command) for command in station.commands},
            "cmd_response": {
                "address": f"{station.root}/cmd/{{verb}}/response",
                "description": "the answer, with the request's transaction",
                "parameters": {"verb": {"description": "that of the request, served or not"}},
                "messages": {"CommandResponse": {"$ref": "#/components/messages/CommandResponse"}},
            },
        },
        "operations": {
            **{f"send_{_key(topic)}": _sends(topic) for topic in published},
            **{f"receive_{command.verb}": _receives(command) for command in station.commands},
        },
        "components": {
            "schemas": {**schemas, **requests},
            "messages": {
                **dict(_message(station, topic) for topic in published),
                "Empty": _EMPTY,
                "CommandResponse": _of(CommandResponse),
            },
        },
    }


_EMPTY: Final = {
    "summary": "nothing here: the retained message is removed",
    "payload": {"type": "string", "maxLength": 0},
}


def _key(topic: Topic) -> str:
    return re.sub(r"\W+", "_", re.sub(r"/?<.*?>", "", topic.name))


def _message_name(topic: Topic) -> str:
    return f"{_key(topic)}_{topic.payload}" if isinstance(topic.payload, str) else topic.payload.__name__


def _message(station: DescribedStation, topic: Topic) -> tuple[str, dict[str, Any]]:
    if not isinstance(topic.payload, str):
        return _message_name(topic), _of(topic.payload)
    content_type, payload = {**_CONTENT, "picture": (station.picture_type, _BINARY)}[topic.payload]
    return _message_name(topic), {"contentType": content_type, "payload": payload}


def _of(model: type[BaseModel]) -> dict[str, Any]:
    return {
        "summary": (model.__doc__ or "").partition("\n")[0],
        "contentType": "application/json",
        "payload": {"$ref": REFERENCE.format(model=model.__name__)},
    }


def _channel(station: DescribedStation, topic: Topic) -> dict[str, Any]:
    named = {name: re.sub(r"\W", "_", name) for name in re.findall(r"<(.*?)>", topic.name)}
    address = topic.name
    for name, parameter in named.items():
        address = address.replace(f"<{name}>", f"{{{parameter}}}")
    is_sent = station.keeps_heatmap or topic.name != "last/heatmap"
    names = [*([_message_name(topic)] if is_sent else []), *(["Empty"] if topic.may_be_empty else [])]
    channel: dict[str, Any] = {
        "address": f"{station.root}/{address}",
        "description": topic.meaning,
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in names},
    }
    if named:
        channel["parameters"] = {parameter: _parameter(name) for name, parameter in named.items()}
    return channel


def _sends(topic: Topic) -> dict[str, Any]:
    return {
        "action": "send",
        "channel": {"$ref": f"#/channels/{_key(topic)}"},
        "summary": topic.meaning,
        "bindings": {"mqtt": {"qos": topic.qos, "retain": topic.is_retained, "bindingVersion": "0.2.0"}},
    }


def _request_channel(station: DescribedStation, command: DescribedCommand) -> dict[str, Any]:
    signed = " Only with a signature." if command.verb in station.signed else ""
    payload = {"$ref": REFERENCE.format(model=_request_name(command))}
    return {
        "address": f"{station.root}/cmd/{command.verb}",
        "description": f"{command.help}.{signed}",
        "messages": {"request": {"contentType": "application/json", "payload": payload}},
    }


def _request_name(command: DescribedCommand) -> str:
    return f"{command.verb}_request"


def _receives(command: DescribedCommand) -> dict[str, Any]:
    return {
        "action": "receive",
        "channel": {"$ref": f"#/channels/cmd_{command.verb}"},
        "summary": command.help,
        "bindings": {"mqtt": {"qos": 1, "retain": False, "bindingVersion": "0.2.0"}},
        "reply": {"channel": {"$ref": "#/channels/cmd_response"}},
    }


@cache
def payload_schemas(models: tuple[type[BaseModel], ...]) -> Mapping[str, Any]:
    """Make the schemas of published payloads, draft-07, by the model's name, with the definitions that they need.

    Every field is required, as it is always there. Fields that are not known are allowed: a later version adds some.
    """
    _, schema = models_json_schema([(model, "serialization") for model in models], ref_template=REFERENCE)
    return {name: _draft_07(model) for name, model in schema["$defs"].items()}


@cache
def request_schema(request: type[BaseModel], arguments: type[BaseModel]) -> Mapping[str, Any]:
    """Make the schema of a request with the arguments of one verb. It refuses unknown fields, as the station does."""
    schema = _draft_07(request.model_json_schema(), keeps_closed=True)
    schema["properties"]["arguments"] = _draft_07(arguments.model_json_schema(), keeps_closed=True)
    return dict(schema)


def _draft_07(schema: Any, *, keeps_closed: bool = False) -> Any:
    """Remove what only later drafts know, and the defaults and titles that pydantic adds."""
    read = partial(_draft_07, keeps_closed=keeps_closed)
    if isinstance(schema, list):
        return [read(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {}
    for key, value in schema.items():
        if key == "properties":
            kept[key] = {name: read(item) for name, item in value.items()}
        elif key == "prefixItems":
            kept["items"] = read(value)
        elif key not in ("title", "default") and (keeps_closed or (key, value) != _CLOSED):
            kept[key] = read(value)
    return kept
