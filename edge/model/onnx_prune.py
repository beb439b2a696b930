"""Cuts a trunk after the deepest tap that is used, because onnxruntime computes every output.

The cut works on protobuf fields and keeps the bytes of every remaining node and weight. So it needs no onnx package,
and equal trunks give equal cuts.

Ref: onnx/onnx.proto3 (field numbers), protobuf encoding guide (wire types).
"""

from collections.abc import Iterable, Sequence

from edge.model.onnx_validation import fields, output_names
from edge.model.protobuf import encode_field

__all__ = ["cut_trunk"]

# onnx.proto3, ModelProto and GraphProto.
_GRAPH = 7
_NODE, _INITIALIZER, _OUTPUT, _VALUE_INFO, _QUANTIZATION = 1, 5, 12, 13, 14
# NodeProto, TensorProto, and the ValueInfoProto and TensorAnnotation whose first field is a name.
_NODE_INPUT, _NODE_OUTPUT, _NODE_ATTRIBUTE = 1, 2, 5
_TENSOR_NAME, _FIRST_NAME = 8, 1
# AttributeProto: a node with a subgraph may read any value by name.
_SUBGRAPHS = (6, 11)


def cut_trunk(graph: bytes, taps: Sequence[str]) -> bytes:
    """The trunk up to the last of these taps in the order of its outputs; the outputs before it stay.

    So one backbone has at most as many cuts as taps, and parts that use the same deepest tap share one file. The bytes
    are unchanged if nothing can be cut, a tap is not among the outputs, or nodes have subgraphs. Errors: GraphRefused
    for bytes that are not a model.
    """
    given = output_names(graph)
    if not taps or not set(taps) <= set(given):
        return graph
    kept = given[: max(given.index(tap) for tap in taps) + 1]
    if kept == given:
        return graph
    parts = []
    for number, value in fields(memoryview(graph)):
        if number == _GRAPH and isinstance(value, memoryview):
            short = _cut(value, kept)
            if short is None:
                return graph
            value = memoryview(short)
        parts.append(encode_field(number, value))
    return b"".join(parts)


def _cut(graph: memoryview, kept: Sequence[str]) -> bytes | None:
    """The graph's bytes with only these outputs, None where a node has a subgraph."""
    content = list(fields(graph))
    nodes = [value for number, value in content if number == _NODE and isinstance(value, memoryview)]
    if any(_has_subgraph(node) for node in nodes):
        return None
    used, needed = _trace_back(nodes, kept)
    return b"".join(
        encode_field(number, value)
        for number, value in content
        if not isinstance(value, memoryview) or _stays(number, value, used, needed, kept)
    )


def _stays(number: int, value: memoryview, used: set[int], needed: set[bytes], kept: Sequence[str]) -> bool:
    if number == _NODE:
        return id(value) in used
    if number == _OUTPUT:
        return _name(value, _FIRST_NAME).decode("utf-8", "replace") in kept
    if number == _INITIALIZER:
        return _name(value, _TENSOR_NAME) in needed
    if number in (_VALUE_INFO, _QUANTIZATION):
        return _name(value, _FIRST_NAME) in needed
    return True


def _trace_back(nodes: Sequence[memoryview], kept: Iterable[str]) -> tuple[set[int], set[bytes]]:
    """Find the nodes (by identity) that these outputs need, and the names of every value that they read or give.

    Nodes are in the order of computation, as ONNX requires.
    """
    needed = {name.encode() for name in kept}
    used: set[int] = set()
    for node in reversed(nodes):
        given = _names(node, _NODE_OUTPUT)
        if not needed.isdisjoint(given):
            used.add(id(node))
            needed.update(given)
            needed.update(_names(node, _NODE_INPUT))
    return used, needed


def _has_subgraph(node: memoryview) -> bool:
    attributes = (value for number, value in fields(node) if number == _NODE_ATTRIBUTE)
    return any(
        number in _SUBGRAPHS
        for attribute in attributes
        if isinstance(attribute, memoryview)
        for number, _ in fields(attribute)
    )


def _names(message: memoryview, field: int) -> list[bytes]:
    return [
        bytes(value)
        for number, value in fields(message)
        if number == field and isinstance(value, memoryview) and len(value)
    ]


def _name(message: memoryview, field: int) -> bytes:
    return next(iter(_names(message, field)), b"")
