"""docs/mqtt.md, printed from the payload models, so that both always agree."""

import json
from collections.abc import Iterable, Iterator
from typing import Any, Final, Protocol

from pydantic import BaseModel

from edge.core.sink_context import TOPIC_VERSION
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES, WAITING_REQUESTS
from edge.messaging.payload_base import Payload
from edge.messaging.request_signature import signature_of, signed_text
from edge.messaging.topics import TOPICS
from edge.pictures.heatmap import FULL_SCALE
from edge.pictures.press_picture import LARGEST_BYTES, TEXT_KEYWORDS

__all__ = ["DocumentedCommand", "reference"]


class DocumentedCommand(Protocol):
    """A command on the page: its verb, the model of its arguments, and its effect."""

    @property
    def verb(self) -> str: ...
    @property
    def arguments(self) -> type[BaseModel]: ...
    @property
    def help(self) -> str: ...
    @property
    def changes(self) -> str: ...


_EXAMPLE_ROOT: Final = "gelgate/plant/line1/station1/gel/v1"
_EXAMPLE_SECRET: Final = "0123456789abcdef0123456789abcdef"
_EXAMPLE_NS: Final = 1_780_000_000_000_000_000

_ASKING: Final = """
`[commands]` of the configuration says which verbs a station serves: `unsigned` ones from everybody whom the broker lets
publish on `cmd/<verb>`, `signed` ones with a signature. By default only `trigger` is served. A verb that changes
something belongs under `signed`, or the broker's access rules must allow its topic to few.

A request is a JSON object of at most {largest} bytes, published with QoS 1 and not retained:

```json
{{"transaction": "17"}}
```

- The same verb and transaction id within a minute are the same request, because MQTT delivers at least once: it is not
  done twice, and the answer with `is_repeated` is the first outcome. Use a new id for each request.
- The response is published on `cmd/<verb>/response`. At level 5 a request may name a response topic below that one;
  with any other the request is refused.
- Signed, unsigned and page requests each have their own `requests_per_minute`, counted after the check. More of them,
  larger ones, and those that find {waiting} others waiting are refused, with a response.
- Every request that is done or fails is in the table of acts, `gelgate station acts`, and of the refused
  `requests_per_minute`.

A signed request also has `by`, `time_ns` (within 60 s of the station's clock) and `signature`. The signature is the
HMAC-SHA256, in hexadecimal, of one JSON text with sorted keys, without blanks, and with `\\u` escapes for everything
that is not ASCII. With the secret `{secret}` this text

```json
{text}
```

gives this request on `cmd/replace_gel`:

```json
{request}
```"""

_HEAD: Final = f"""\
# MQTT topics and payloads

A reference, printed by `gelgate station topics` from the payload models.

Every topic is below `<prefix>/<site>/<line>/<station>/gel/{TOPIC_VERSION}/`. The four levels come from the
configuration: 1 to 64 characters each, without blanks and without `+ # / $`.

Payloads are JSON in UTF-8, except the pictures. Every field is always there; its type says whether it may be null.
Within {TOPIC_VERSION} fields may be added: ignore those you do not know. Units are in the names. `time_ns` is for
programs with 64-bit integers: JavaScript, and so Node-RED, rounds integers above 2^53 without an error.

A subscriber can rely on this:

- **A result arrives at least once**, and again only with the same `press_id` and content, but for `is_replayed`: drop
  the second by its id.
- **Results keep their order** at one broker. A result that is sent late is marked `is_replayed`; its `time` is that of
  the press. A refused message is kept and comes later, out of order.
- **`last/press` and `gel` never go back in time.** While the broker is away only their newest is kept.
- **`last/heatmap` comes just before its `last/press`** and is empty for a press without a picture, so the two always
  belong together. The press id is in the picture's text chunks as well.
- **`availability` is `offline` once the gateway is gone**, however it ended: the broker publishes that itself. `online`
  says that the gateway runs, not that it inspects: `state` says that.
- **A press without a score is never a pass**: its `verdict` is null and `error` says why.
- **No press is missing while `sequence` rises by one.** It is counted in the station's database, in the transaction
  that records the press. `gel_presses` starts again with every gel.
- **An empty payload on a retained topic means "nothing here"**: look at its length before you parse it. On every
  connection each `alarm/<alarm>` that is not raised is emptied, so that no alarm outlives the process that raised it.
- `state`, `availability`, `info`, `alarm` and `stats` are the current ones. They are not kept for later, and are sent
  again on every connection.
- MQTT 5 and 3.1.1 carry the same topics and payloads. At level 5 messages also have a content type, a request may name
  its response topic, and the correlation data comes back. At 3.1.1 a broker may discard forbidden messages without an
  error.
- The client id of a station must be unique: two stations with one id disconnect each other for ever.
"""


_PICTURES: Final = f"""
## Pictures

`overview/<press id>` is a JPEG of the overview camera, taken when the contact began; only stations with `[overview]`
send it. A still of at most `max_side_px` is the camera's own JPEG.

`heatmap/<press id>` and `last/heatmap` are PNG files of 8-bit RGB. Left is the inspected region as the sensor saw it,
with a line around each part above the threshold. Right are the scores in colour, from 0 to {FULL_SCALE:g} times the
threshold, the same for every press and every detector. The colour map is Inferno: its lightness rises evenly with the
score, so it also works in grey and for colour-blind people. A scale bar, verdict, score and names are around them. The
text chunks (iTXt) hold {{keywords}}. A file has at most
{LARGEST_BYTES >> 20} MiB: a picture that compresses worse is drawn smaller.
"""


def reference(commands: Iterable[DocumentedCommand]) -> str:
    """The complete page, Markdown. commands: those of a station."""
    pictures = _PICTURES.format(keywords=", ".join(f"`{keyword}`" for keyword in TEXT_KEYWORDS))
    parts = [_HEAD, *_overview(), pictures.rstrip(), *_commands(commands), *_alarms(), *_payloads()]
    return "\n".join(parts) + "\n"


def _overview() -> Iterator[str]:
    yield "## Topics\n\n| topic | QoS | retained | payload | what it is |\n| --- | --- | --- | --- | --- |"
    for topic, qos, retained, payload, meaning, _ in TOPICS:
        name = payload if isinstance(payload, str) else f"[{payload.__name__}](#{payload.__name__.lower()})"
        yield f"| `{topic}` | {qos} | {'yes' if retained else 'no'} | {name} | {meaning} |"


def _commands(commands: Iterable[DocumentedCommand]) -> Iterator[str]:
    yield "\n## Commands\n\n| verb | arguments | what it does | what it changes |\n| --- | --- | --- | --- |"
    for one in commands:
        yield f"| `{one.verb}` | {_arguments(one.arguments)} | {one.help} | {one.changes or 'nothing'} |"
    arguments = {"gel_id": "batch7-3", "note": "torn"}
    text = signed_text(_EXAMPLE_ROOT, "replace_gel", "17", _EXAMPLE_NS, "kim", arguments)
    fields = {"transaction": "17", "arguments": arguments, "by": "kim", "time_ns": _EXAMPLE_NS}
    request = {**fields, "signature": signature_of(_EXAMPLE_SECRET.encode(), text)}
    yield _ASKING.format(
        secret=_EXAMPLE_SECRET,
        text=text.decode(),
        request=json.dumps(request),
        largest=LARGEST_REQUEST_BYTES,
        waiting=WAITING_REQUESTS,
    )


def _arguments(model: type[BaseModel]) -> str:
    fields = model.model_fields.items()
    names = [f"`{name}`" + ("" if field.is_required() else " (optional)") for name, field in fields]
    return ", ".join(names) or "none"


def _alarms() -> Iterator[str]:
    yield "\n## Alarms\n\n| alarm | meaning |\n| --- | --- |"
    yield from (f"| `{alarm}` | {meaning} |" for alarm, meaning in ALARMS.items())


def _payloads() -> Iterator[str]:
    yield from _fields("## Every payload of a station", Payload.model_json_schema(), {})
    for model in dict.fromkeys(one.payload for one in TOPICS if not isinstance(one.payload, str)):
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
        yield f"| `{name}` | {_kind(field, definitions)} | {_meaning(field)} |"


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


def _meaning(field: dict[str, Any]) -> str:
    return str(field.get("description", "")).replace("|", "or").replace("\n", " ")
