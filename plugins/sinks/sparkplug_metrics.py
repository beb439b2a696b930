"""From the station's messages to the metrics of its Sparkplug node."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Any, Final

from edge.core.ports import Message
from edge.messaging.alarm_payload import list_alarms

__all__ = ["DataType", "Metric", "decode", "encode", "initial_metrics", "metrics_of"]


# No generated code, so no lock on a version of protobuf, which onnxruntime brings.
# Ref: Eclipse Sparkplug 3.0.0, 6.4 (payload components) and its sparkplug_b.proto.
class DataType(IntEnum):
    """The data types in use, with the numbers of the specification."""

    INT64 = 4
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12


Value = int | float | bool | str


@dataclass(frozen=True)
class Metric:
    """One value."""

    name: str
    kind: DataType
    value: Value | None
    """None is null."""
    time_ms: int
    """Milliseconds since 1970 UTC."""
    is_historical: bool = False
    """The value is of a moment in the past, sent late."""


# Field of the oneof `value`: its name by data type. Numbers and types of all fields are in _PROTO_FIELDS.
_VALUES: Final = {
    DataType.INT64: "long_value",
    DataType.DOUBLE: "double_value",
    DataType.BOOLEAN: "boolean_value",
    DataType.STRING: "string_value",
}

# (name, number, type) of proto2 fields, all optional. The other fields of the specification are not sent.
_PROTO_FIELDS: Final = {
    "Metric": (
        ("name", 1, "STRING"),
        ("alias", 2, "UINT64"),
        ("timestamp", 3, "UINT64"),
        ("datatype", 4, "UINT32"),
        ("is_historical", 5, "BOOL"),
        ("is_null", 7, "BOOL"),
        ("long_value", 11, "UINT64"),
        ("double_value", 13, "DOUBLE"),
        ("boolean_value", 14, "BOOL"),
        ("string_value", 15, "STRING"),
    ),
    "Payload": (("timestamp", 1, "UINT64"), ("seq", 3, "UINT64")),
}
_METRICS_FIELD: Final = 2


def encode(metrics: Sequence[Metric], time_ms: int, seq: int | None) -> bytes:
    """The payload. seq: 0 to 255; None in a death certificate, which has none."""
    payload = _payload_class()(timestamp=time_ms)
    if seq is not None:
        payload.seq = seq
    for metric in metrics:
        entry = payload.metrics.add(name=metric.name, timestamp=metric.time_ms, datatype=metric.kind)
        if metric.is_historical:
            entry.is_historical = True
        if metric.value is None:
            entry.is_null = True
        else:
            value = metric.value
            # A negative number is sent as its two's complement: the field is unsigned.
            setattr(entry, _VALUES[metric.kind], value % 2**64 if metric.kind is DataType.INT64 else value)
    return bytes(payload.SerializeToString())


def decode(data: bytes) -> list[tuple[str, Value | None]]:
    """Names and values of a payload's metrics; values of other types are None. Errors: ValueError."""
    from google.protobuf.message import DecodeError

    payload = _payload_class()()
    try:
        payload.ParseFromString(data)
    except DecodeError as error:
        raise ValueError(f"not a Sparkplug B payload: {error}") from error
    return [(entry.name, _value(entry)) for entry in payload.metrics]


def _value(metric: Any) -> Value | None:
    for name in _VALUES.values():
        if metric.HasField(name):
            value: Value = getattr(metric, name)
            return value
    return None


@cache
def _payload_class() -> Any:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    field = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name="gelgate/sparkplug_b.proto", package="gelgate.sparkplug", syntax="proto2"
    )
    for message, fields in _PROTO_FIELDS.items():
        made = file.message_type.add(name=message)
        for name, number, kind in fields:
            made.field.add(
                name=name, number=number, type=getattr(field, f"TYPE_{kind}"), label=field.LABEL_OPTIONAL
            )
    file.message_type[-1].field.add(
        name="metrics",
        number=_METRICS_FIELD,
        type=field.TYPE_MESSAGE,
        type_name=".gelgate.sparkplug.Metric",
        label=field.LABEL_REPEATED,
    )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("gelgate.sparkplug.Payload"))


_S, _I, _D, _B = DataType.STRING, DataType.INT64, DataType.DOUBLE, DataType.BOOLEAN
_TYPES: Final[Mapping[DataType, type[Value]]] = {_S: str, _I: int, _D: float, _B: bool}

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
        ("Press/Piece", _S, "piece_id"),
        ("Press/Place", _S, "place"),
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
    "piece": (("Piece/In Progress", _S, "piece_id"),),
    "piece_result": (
        ("Piece/Id", _S, "piece_id"),
        ("Piece/Verdict", _S, "verdict"),
        ("Piece/Ended By", _S, "ended_by"),
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
    return [*fields, *(Metric(f"Alarm/{alarm}", _B, False, time_ms) for alarm in list_alarms())]


def metrics_of(message: Message, time_ms: int) -> Iterator[Metric]:
    """The metrics that a message changes; none for pictures and for what has no metric.

    time_ms: where it has no time of its own. Errors: ValueError, TypeError for what is not the station's JSON.
    """
    kind, _, alarm = message.topic.partition("/")
    if kind == "alarm":
        yield Metric(f"Alarm/{alarm}", _B, bool(message.payload), time_ms)
    elif message.topic in _FIELDS:
        content = json.loads(message.payload or b"{}")  # empty: the station has no `[piece]` any more
        if not isinstance(content, dict):
            raise ValueError("expected a JSON object")
        own_ms, is_late = content.get("time_ms", time_ms), bool(content.get("is_replayed", False))
        for name, data_type, field in _FIELDS[message.topic]:
            value = content.get(field)
            typed = None if value is None else _TYPES[data_type](value)
            yield Metric(name, data_type, typed, own_ms, is_late)
