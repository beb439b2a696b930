"""Checks the messages of stations against the AsyncAPI document that each station keeps at the broker.

It knows the document alone, not the payload models: what passes here can be read by a subscriber who has no more.
"""

import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from edge.core.sink_context import TOPIC_VERSION
from edge.messaging.mqtt_broker import Received

if TYPE_CHECKING:
    from jsonschema import Draft7Validator

__all__ = ["DocumentCheck", "StationsCheck"]

# Messages of a station that wait for its document; retained ones arrive in any order, and at once.
MOST_WAITING: Final = 10_000

# A reference to a reference is followed this often.
MOST_REFERENCES: Final = 8

_Check = Callable[[bytes], str | None]

_IMAGES: Final = {"image/png": b"\x89PNG\r\n\x1a\n", "image/jpeg": b"\xff\xd8\xff"}


class DocumentCheck:
    """The messages that one document describes. Errors: ValueError for a document that cannot be used."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        from jsonschema import SchemaError

        self._document = document
        self._channels: list[tuple[re.Pattern[str], list[_Check]]] = []
        try:
            for channel in map(self._resolve, self._sending_channels()):
                parts = re.split(r"({.*?})", channel["address"])
                address = "".join("[^/]+" if part.startswith("{") else re.escape(part) for part in parts)
                messages = map(self._resolve, channel["messages"].values())
                self._channels.append((re.compile(address), list(map(self._make_check, messages))))
        except (KeyError, TypeError, AttributeError, ValueError, SchemaError) as error:
            raise ValueError(
                f"not an AsyncAPI 3 document with channels and operations: {error!r:.300}"
            ) from error

    def fault(self, topic: str, payload: bytes) -> str | None:
        """Say in one sentence what is wrong with a message; None if the document describes it."""
        for pattern, messages in self._channels:
            if pattern.fullmatch(topic):
                faults = [check(payload) for check in messages]
                return None if None in faults else faults[0]
        return "no channel of the document has this topic"

    def _sending_channels(self) -> Iterable[Mapping[str, Any]]:
        """List the channels on which the station sends, each once."""
        operations = self._document["operations"].values()
        references = [operation["channel"] for operation in operations if operation["action"] == "send"]
        references += [operation["reply"]["channel"] for operation in operations if "reply" in operation]
        return {reference["$ref"]: reference for reference in references}.values()

    def _resolve(self, value: Mapping[str, Any]) -> Any:
        resolved: Any = value
        for _ in range(MOST_REFERENCES):
            if "$ref" not in resolved:
                return resolved
            resolved, path = self._document, str(resolved["$ref"]).removeprefix("#/").split("/")
            for level in path:
                resolved = resolved[level]
        raise ValueError("a reference leads to itself")

    def _make_check(self, message: Mapping[str, Any]) -> _Check:
        """Make what tells the fault of a payload, None for a sound one."""
        from jsonschema import Draft7Validator

        schema = {"allOf": [message["payload"]], "components": self._document.get("components", {})}
        Draft7Validator.check_schema(schema)
        return partial(_fault, message.get("contentType"), Draft7Validator(schema))


def _fault(content_type: str | None, validator: "Draft7Validator", payload: bytes) -> str | None:
    from jsonschema.exceptions import best_match
    from referencing.exceptions import Unresolvable

    if content_type in _IMAGES:
        return None if payload.startswith(_IMAGES[content_type]) else f"it is no {content_type}"
    try:
        text = payload.decode()
        fault = best_match(
            validator.iter_errors(json.loads(text) if content_type == "application/json" else text)
        )
    except (ValueError, RecursionError, Unresolvable) as error:
        return f"it cannot be read as {content_type or 'text'} ({error})"
    return None if fault is None else f"{fault.json_path}: {fault.message:.300}"


class StationsCheck:
    """Every message of any number of stations. checked: how many were; they wait until their document is here."""

    def __init__(self) -> None:
        self.checked = 0
        self._documents: dict[str, DocumentCheck] = {}
        self._waiting: dict[str, list[Received]] = defaultdict(list)
        self._left_out = Counter[str]()

    @property
    def undescribed(self) -> Mapping[str, int]:
        """Stations whose document has not come, with the number of their messages."""
        return {
            root: len(messages) + self._left_out[root] for root, messages in self._waiting.items() if messages
        }

    @property
    def left_out(self) -> Mapping[str, int]:
        """Stations whose document came after more messages than can wait, with the number of those that did not."""
        return {root: number for root, number in self._left_out.items() if root in self._documents}

    def see(self, message: Received) -> Sequence[str]:
        """The faults of this message, and of those that have waited for it; requests of others are left out."""
        root, marker, topic = message.topic.partition(f"/gel/{TOPIC_VERSION}/")
        if not marker or re.fullmatch(r"cmd/[^/]+", topic):
            return []
        faults = []
        if topic == "asyncapi":
            try:
                self._documents[root] = DocumentCheck(json.loads(message.payload))
            except (ValueError, RecursionError) as error:
                faults.append(f"{message.topic}: {error}")
        if root not in self._documents:
            if len(self._waiting[root]) < MOST_WAITING:
                self._waiting[root].append(message)
            else:
                self._left_out[root] += 1
            return faults
        for waiting in (*self._waiting.pop(root, []), message):
            self.checked += 1
            fault = self._documents[root].fault(waiting.topic, waiting.payload)
            faults += [] if fault is None else [f"{waiting.topic}: {fault}"]
        return faults
