"""Checks what an ONNX file contains before the runtime parses it, by reading its protobuf fields.

A graph in a bundle is refused when it points to data outside its own bytes, uses an operator domain other than the
standard one, a loop or a random operator, or defines its own functions. onnxruntime resolves external data relative to
the working directory when it loads from bytes, so the refusal cannot be left to it; the onnx package is not needed on
the gateway.

Ref: onnx/onnx.proto3 (field numbers), protobuf encoding guide (wire types).
"""

from collections.abc import Iterator
from dataclasses import dataclass

__all__ = ["GraphRefused", "check_graph", "metadata", "output_names"]

STANDARD_DOMAINS = frozenset({b"", b"ai.onnx"})
MAX_NODES = 20_000
MAX_FIELDS = 2_000_000
MAX_DEPTH = 12

# onnx.proto3: message -> {field number: message it holds}; other fields are skipped.
CHILDREN: dict[str, dict[int, str]] = {
    "model": {7: "graph", 8: "opset", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "opset": {},
    "tensor": {},
}
DOMAIN_FIELD = {"opset": 1, "node": 7}
NODE_OPERATOR = ("node", 4)
# A loop may run for ever on one frame, and a random score is none; no detector needs them.
REFUSED_OPERATORS = frozenset(
    {
        b"Loop", b"Scan", b"RandomNormal", b"RandomNormalLike", b"RandomUniform", b"RandomUniformLike", b"Multinomial",
        b"Bernoulli",
    }
)  # fmt: skip
GRAPH_OUTPUT_FIELD = 12
METADATA_FIELD = 14
EXTERNAL_DATA_FIELD, DATA_LOCATION_FIELD = 13, 14


class GraphRefused(ValueError):
    """The bytes are not an ONNX graph that a bundle may carry; the message says why."""


@dataclass
class _Budget:
    nodes: int = MAX_NODES
    fields: int = MAX_FIELDS


def check_graph(data: bytes) -> None:
    """Refuse external data, foreign operator domains, functions, and bytes that are not a model.

    Errors: GraphRefused.
    """
    if not any(number == 7 for number, _ in _fields(memoryview(data), _Budget())):
        raise GraphRefused("it holds no graph")
    _check("model", memoryview(data), _Budget(), 0)


def output_names(data: bytes) -> list[str]:
    """The names of a graph's outputs, without opening a session. Errors: GraphRefused."""
    budget, names = _Budget(), []
    for model_field, graph in _fields(memoryview(data), budget):
        if model_field != 7 or not isinstance(graph, memoryview):
            continue
        for graph_field, value in _fields(graph, budget):
            if graph_field == GRAPH_OUTPUT_FIELD and isinstance(value, memoryview):
                texts = (v for n, v in _fields(value, budget) if n == 1 and isinstance(v, memoryview))
                names += [bytes(text).decode("utf-8", "replace") for text in texts]
    return names


def metadata(data: bytes) -> dict[str, str]:
    """The model's metadata, key to value, without opening a session. Errors: GraphRefused."""
    budget, properties = _Budget(), {}
    for number, entry in _fields(memoryview(data), budget):
        if number == METADATA_FIELD and isinstance(entry, memoryview):
            pair = {n: bytes(v) for n, v in _fields(entry, budget) if isinstance(v, memoryview)}
            key, value = (pair.get(n, b"").decode("utf-8", "replace") for n in (1, 2))
            properties[key] = value
    return properties


def _check(kind: str, message: memoryview, budget: _Budget, depth: int) -> None:
    if depth > MAX_DEPTH:
        raise GraphRefused(f"its graphs are nested more than {MAX_DEPTH} deep")
    for number, value in _fields(message, budget):
        if kind == "tensor" and (number == EXTERNAL_DATA_FIELD or (number == DATA_LOCATION_FIELD and value)):
            raise GraphRefused("it keeps tensors in an external file")
        if not isinstance(value, memoryview):
            continue
        if number == DOMAIN_FIELD.get(kind) and (domain := bytes(value)) not in STANDARD_DOMAINS:
            raise GraphRefused(f"it uses the operator domain '{domain.decode('utf-8', 'replace')}'")
        if (kind, number) == NODE_OPERATOR and (operator := bytes(value)) in REFUSED_OPERATORS:
            raise GraphRefused(
                f"it uses the operator {operator.decode()}, which has no bounded time or no fixed result"
            )
        child = CHILDREN[kind].get(number)
        if child is None:
            continue
        if child == "function":
            raise GraphRefused("it defines its own functions; inline them")
        if child == "node":
            budget.nodes -= 1
            if budget.nodes < 0:
                raise GraphRefused(f"it has more than {MAX_NODES} nodes")
        _check(child, value, budget, depth + 1)


def _fields(message: memoryview, budget: _Budget) -> Iterator[tuple[int, int | memoryview]]:
    """(field number, value) of one message: an int for a varint, a view for a length-delimited field."""
    at, end = 0, len(message)
    while at < end:
        budget.fields -= 1
        if budget.fields < 0:
            raise GraphRefused(f"it has more than {MAX_FIELDS} fields")
        tag, at = _varint(message, at)
        number, wire = tag >> 3, tag & 7
        if wire == 0:
            value, at = _varint(message, at)
            yield number, value
            continue
        if wire not in (1, 2, 5) or number == 0:
            raise GraphRefused("it is not an ONNX model")
        length, at = _varint(message, at) if wire == 2 else (8 if wire == 1 else 4, at)
        if at + length > end:
            raise GraphRefused("it is cut short or is not an ONNX model")
        if wire == 2:
            yield number, message[at : at + length]
        at += length


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise GraphRefused("it is cut short or is not an ONNX model")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise GraphRefused("it is not an ONNX model")
