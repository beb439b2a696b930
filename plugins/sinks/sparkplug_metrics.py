"""From the station's messages to the metrics of its Sparkplug node."""

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

from edge.core.ports import Message
from edge.messaging.alarm_payload import ALARMS
from plugins.sinks.sparkplug_payload import DataType, Metric

__all__ = ["initial_metrics", "metrics_of"]

_S, _I, _D, _B = DataType.STRING, DataType.INT64, DataType.DOUBLE, DataType.BOOLEAN

# topic -> (metric, data type, field of the JSON payload)
_FIELDS: Final[Mapping[str, tuple[tuple[str, DataType, str], ...]]] = {
    "state": (("Station/State", _S, "state"), ("Station/Reason", _S, "reason")),
    "info": (
        ("Station/Software", _S, "gelgate_version"),
        ("Station/Sensor", _S, "sensor_serial"),
        ("Station/Part", _S, "part"),
        ("Station/Position", _S, "position"),
        ("Station/Bundle", _S, "bundle_id"),
        ("Station/Threshold", _D, "threshold"),
    ),
    "result": (
        ("Press/Id", _S, "press_id"),
        ("Press/Sequence", _I, "sequence"),
        ("Press/Part", _S, "part"),
        ("Press/Position", _S, "position"),
        ("Press/Verdict", _S, "verdict"),
        ("Press/Reason", _S, "reason"),
        ("Press/Error", _S, "error"),
        ("Press/Score", _D, "score"),
        ("Press/Threshold", _D, "threshold"),
        ("Press/Score Ratio", _D, "score_ratio"),
        ("Press/Defect Area mm2", _D, "defect_area_mm2"),
        ("Press/Cause", _S, "cause"),
        ("Press/Blind Area mm2", _D, "blind_area_mm2"),
    ),
    "gel": (
        ("Gel/Id", _S, "gel_id"),
        ("Gel/Presses", _I, "presses"),
        ("Gel/Limit", _I, "limit_presses"),
        ("Gel/State", _S, "state"),
    ),
    "stats": (
        ("Stats/Presses", _I, "presses"),
        ("Stats/Frames Dropped", _I, "frames_dropped"),
        ("Stats/Latency ms", _D, "latency_ms_p50"),
        ("Stats/Unsent Messages", _I, "outbox_rows"),
    ),
}


def initial_metrics(time_ms: int) -> list[Metric]:
    """Every metric that the node has, null or not raised: a birth certificate names them all."""
    fields = [Metric(name, kind, None, time_ms) for rows in _FIELDS.values() for name, kind, _ in rows]
    return [*fields, *(Metric(f"Alarm/{alarm}", _B, False, time_ms) for alarm in ALARMS)]


def metrics_of(message: Message, time_ms: int) -> Iterator[Metric]:
    """The metrics that a message changes; none for pictures and for what has no metric.

    time_ms: where it has no time of its own. Errors: ValueError, TypeError for what is not the station's JSON.
    """
    kind, _, alarm = message.topic.partition("/")
    if kind == "alarm":
        yield Metric(f"Alarm/{alarm}", _B, bool(message.payload), time_ms)
    elif message.topic in _FIELDS:
        content = json.loads(message.payload)
        if not isinstance(content, dict):
            raise ValueError("expected a JSON object")
        own_ms, is_late = content.get("time_ms", time_ms), bool(content.get("is_replayed", False))
        for name, data_type, field in _FIELDS[message.topic]:
            yield Metric(name, data_type, _typed(content.get(field), data_type), own_ms, is_late)


def _typed(value: Any, kind: DataType) -> Any:
    if value is None:
        return None
    return {_S: str, _I: int, _D: float, _B: bool}[kind](value)
