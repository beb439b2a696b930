"""Payloads of a station as the page shows them: read by their models, so that nothing malformed gets to a browser.

At a broker anybody may publish, and a station may be newer than this program: fields that are not known are left out,
and so are known ones with a value that cannot be.
"""

import json
from collections.abc import Mapping
from typing import Any, Final

from pydantic import ValidationError

from edge.messaging.alarm_payload import AlarmPayload
from edge.messaging.gel_payload import GelPayload
from edge.messaging.payload_base import Payload
from edge.messaging.reference_payload import ReferencePayload
from edge.messaging.result_payload import ResultPayload
from edge.messaging.status_payloads import InfoPayload, StatePayload, StatsPayload

__all__ = ["LARGEST_PAYLOAD_BYTES", "readable"]

# The largest payload that is read; those of a station have a few thousand bytes.
LARGEST_PAYLOAD_BYTES: Final = 64 << 10

_MODELS: Final[Mapping[str, type[Payload]]] = {
    "state": StatePayload,
    "info": InfoPayload,
    "gel": GelPayload,
    "reference": ReferencePayload,
    "stats": StatsPayload,
    "alarm": AlarmPayload,
    "result": ResultPayload,
}


def readable(kind: str, payload: bytes) -> dict[str, Any]:
    """The fields of a payload of this kind that can be shown. Errors: ValueError, one sentence without the payload."""
    if len(payload) > LARGEST_PAYLOAD_BYTES:
        raise ValueError(f"it has {len(payload)} bytes, a payload has at most {LARGEST_PAYLOAD_BYTES}")
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise ValueError("it is not JSON") from error
    if not isinstance(content, dict):
        raise ValueError("expected a JSON object")
    model = _MODELS[kind]
    known = {key: value for key, value in content.items() if key in model.model_fields}
    for key in _faulty(model, known):
        known.pop(key, None)
    if fault := _faulty(model, known):
        raise ValueError(f"it is not what a station says ({', '.join(sorted(fault))})")
    return model.model_validate(known, strict=False).model_dump(mode="json", include=set(known))


def _faulty(model: type[Payload], content: Mapping[str, Any]) -> set[str]:
    """The fields that are not as the model has them; `fields that contradict each other` for several together.

    Lists are read as the tuples of the model, so not strictly; what is shown is what was read.
    """
    try:
        model.model_validate(dict(content), strict=False)
    except ValidationError as error:
        return {
            str(one["loc"][0]) if one["loc"] else "fields that contradict each other"
            for one in error.errors(include_url=False, include_input=False, include_context=False)
        }
    return set()
