"""JSON Schemas of the payloads, draft-07: the dialect that AsyncAPI takes without a word about the format."""

from collections.abc import Iterable
from functools import partial
from typing import Any, Final

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

__all__ = ["REFERENCE", "payload_schemas", "request_schema"]

REFERENCE: Final = "#/components/schemas/{model}"

_CLOSED: Final = ("additionalProperties", False)


def payload_schemas(models: Iterable[type[BaseModel]]) -> dict[str, Any]:
    """Make the schemas of payloads that a station publishes, by the model's name, with the definitions that they need.

    Every field is required, as it is always there. Fields that are not known are allowed: a later version adds some.
    """
    _, schema = models_json_schema([(model, "serialization") for model in models], ref_template=REFERENCE)
    return {name: _draft_07(one) for name, one in schema["$defs"].items()}


def request_schema(request: type[BaseModel], arguments: type[BaseModel]) -> dict[str, Any]:
    """Make the schema of a request with the arguments of one verb. It refuses unknown fields, as the station does."""
    schema = _draft_07(request.model_json_schema(), keeps_closed=True)
    schema["properties"]["arguments"] = _draft_07(arguments.model_json_schema(), keeps_closed=True)
    return dict(schema)


def _draft_07(schema: Any, *, keeps_closed: bool = False) -> Any:
    """Remove what only later drafts know, and the defaults and titles that pydantic adds."""
    read = partial(_draft_07, keeps_closed=keeps_closed)
    if isinstance(schema, list):
        return [read(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {}
    for key, value in schema.items():
        if key == "properties":
            kept[key] = {name: read(one) for name, one in value.items()}
        elif key == "prefixItems":
            kept["items"] = read(value)
        elif key not in ("title", "default") and (keeps_closed or (key, value) != _CLOSED):
            kept[key] = read(value)
    return kept
