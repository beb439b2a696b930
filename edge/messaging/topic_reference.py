"""docs/mqtt.md, printed from the payload models, so that both always agree."""

import json
from collections.abc import Iterable, Iterator
from importlib.resources import files
from string import Template
from typing import Any, Final

from pydantic import BaseModel

from edge.core.sink_context import TOPIC_VERSION
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES, WAITING_REQUESTS, signature_of, signed_text
from edge.messaging.descriptions.station import DescribedCommand
from edge.messaging.payload_base import Payload
from edge.messaging.topics import TOPICS
from edge.pictures.heatmap import FULL_SCALE
from edge.pictures.press_picture import CELL, LARGEST_BYTES, SCALE_KEYWORDS, TEXT_KEYWORDS

__all__ = ["reference"]


_EXAMPLE_ROOT: Final = "gelgate/plant/line1/station1/gel/v1"
_EXAMPLE_SECRET: Final = "0123456789abcdef0123456789abcdef"
_EXAMPLE_NS: Final = 1_780_000_000_000_000_000


def reference(commands: Iterable[DescribedCommand]) -> str:
    """Print the complete page, Markdown. commands: those of a station."""
    arguments = {"gel_id": "batch7-3", "note": "torn"}
    text = signed_text(_EXAMPLE_ROOT, "replace_gel", "17", _EXAMPLE_NS, "kim", arguments)
    fields = {"transaction": "17", "arguments": arguments, "by": "kim", "time_ns": _EXAMPLE_NS}
    request = {**fields, "signature": signature_of(_EXAMPLE_SECRET.encode(), text)}
    page = files("edge.messaging").joinpath("topic_reference.md").read_text(encoding="utf-8")
    return Template(page).substitute(
        version=TOPIC_VERSION,
        topics="\n".join(_overview()),
        full_scale=f"{FULL_SCALE:g}",
        keywords=_list(TEXT_KEYWORDS),
        cell=CELL,
        scale=_list(SCALE_KEYWORDS),
        largest_mib=LARGEST_BYTES >> 20,
        commands="\n".join(_commands(commands)),
        largest=LARGEST_REQUEST_BYTES,
        waiting=WAITING_REQUESTS,
        secret=_EXAMPLE_SECRET,
        text=text.decode(),
        request=json.dumps(request),
        alarms=_list(ALARMS),
        payloads="\n".join(_payloads()),
    )


def _list(keywords: Iterable[str]) -> str:
    return ", ".join(f"`{keyword}`" for keyword in keywords)


def _overview() -> Iterator[str]:
    yield "## Topics\n\n| topic | QoS | retained | payload | what it is |\n| --- | --- | --- | --- | --- |"
    for topic, qos, retained, payload, meaning, _ in TOPICS:
        name = payload if isinstance(payload, str) else f"[{payload.__name__}](#{payload.__name__.lower()})"
        yield f"| `{topic}` | {qos} | {'yes' if retained else 'no'} | {name} | {meaning} |"


def _commands(commands: Iterable[DescribedCommand]) -> Iterator[str]:
    yield "\n## Commands\n\n| verb | arguments | what it does | what it changes |\n| --- | --- | --- | --- |"
    for command in commands:
        arguments, changes = _arguments(command.arguments), command.changes or "nothing"
        yield f"| `{command.verb}` | {arguments} | {command.help} | {changes} |"


def _arguments(model: type[BaseModel]) -> str:
    fields = model.model_fields.items()
    names = [f"`{name}`" + ("" if field.is_required() else " (optional)") for name, field in fields]
    return ", ".join(names) or "none"


def _payloads() -> Iterator[str]:
    yield from _fields("## Every payload of a station", Payload.model_json_schema(), {})
    for model in dict.fromkeys(topic.payload for topic in TOPICS if not isinstance(topic.payload, str)):
        schema = model.model_json_schema()
        if issubclass(model, Payload):
            schema["properties"] = {
                k: v for k, v in schema["properties"].items() if k not in Payload.model_fields
            }
        inner = schema.get("$defs", {})
        yield from _fields(f"## {model.__name__}", schema, inner)
        for name, part in inner.items():
            if "properties" in part:
                yield from _fields(f"### {name}", part, inner)


def _fields(title: str, schema: dict[str, Any], definitions: dict[str, Any]) -> Iterator[str]:
    yield f"\n{title}\n\n{schema.get('description', '')}\n"
    yield "| field | type | meaning |\n| --- | --- | --- |"
    for name, field in schema["properties"].items():
        meaning = str(field.get("description", "")).replace("|", "or").replace("\n", " ")
        yield f"| `{name}` | {_kind(field, definitions)} | {meaning} |"


def _kind(field: dict[str, Any], definitions: dict[str, Any]) -> str:
    if "$ref" in field:
        return _kind(definitions[field["$ref"].rpartition("/")[2]], definitions)
    if "anyOf" in field:
        return " or ".join(_kind(choice, definitions) for choice in field["anyOf"])
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return " · ".join(f"`{value}`" for value in field["enum"])
    if field.get("type") == "object":
        inner = field.get("additionalProperties")
        return f"object of {_kind(inner, definitions)}" if isinstance(inner, dict) and inner else "object"
    return str(field.get("type", "any"))
