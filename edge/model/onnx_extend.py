"""Appends operations to a head whose result becomes the head's own, without the onnx package.

The head's values of that name are renamed; every other byte of it stays.

Ref: onnx/onnx.proto3 (field numbers).
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from edge.model.onnx_validation import GraphRefused, fields
from edge.model.protobuf import Field, encode_field, message

__all__ = ["Operation", "extend_head", "inputs_of", "opset_of"]

# onnx.proto3, ModelProto, GraphProto and the entries used here.
_GRAPH, _OPSET, _OPSET_VERSION = 7, 8, 2
_NODE, _INITIALIZER, _INPUT, _VALUE_INFO = 1, 5, 11, 13
_NODE_INPUT, _NODE_OUTPUT, _NODE_NAME, _NODE_KIND, _NODE_ATTRIBUTE = 1, 2, 3, 4, 5
_SUBGRAPHS = (6, 11)
_FLOAT, _INT64, _INT_ATTRIBUTE = 1, 7, 2
_FIRST_NAME = 1


@dataclass(frozen=True)
class Operation:
    """One standard operation.

    axes: for a reduction, an int64 constant of the graph. is_kept: whether the axes stay, with one element each.
    """

    kind: str
    inputs: tuple[str, ...]
    output: str
    axes: tuple[int, ...] = ()
    is_kept: bool = False


def extend_head(
    head: bytes,
    renamed: Mapping[str, str],
    inputs: Mapping[str, Sequence[int]],
    operations: Sequence[Operation],
    constants: Mapping[str, float] = MappingProxyType({}),
) -> bytes:
    """Append operations to the head.

    renamed: values of the head to their new names; an operation gives each of the old ones. inputs: name to shape of
    each further float32 input. constants: name to value of each further float32 constant, (1, 1). Errors: GraphRefused
    for bytes that are not a model, or nodes with subgraphs.
    """
    more = b"".join(_encode_additions(inputs, operations, constants))
    parts = []
    for number, value in fields(memoryview(head)):
        if number == _GRAPH and isinstance(value, memoryview):
            parts.append(encode_field(number, b"".join(_rename_values(value, renamed)) + more))
        else:
            parts.append(encode_field(number, value))
    return b"".join(parts)


def opset_of(head: bytes) -> int:
    """The version of the standard operators. Errors: GraphRefused."""
    return max(
        (
            version
            for number, entry in fields(memoryview(head))
            if number == _OPSET and isinstance(entry, memoryview)
            for field, version in fields(entry)
            if field == _OPSET_VERSION and isinstance(version, int)
        ),
        default=0,
    )


def inputs_of(head: bytes) -> list[str]:
    """The names of its inputs. Errors: GraphRefused."""
    return [
        _first_name(entry)
        for number, graph in fields(memoryview(head))
        if number == _GRAPH and isinstance(graph, memoryview)
        for field, entry in fields(graph)
        if field == _INPUT and isinstance(entry, memoryview)
    ]


def _rename_values(graph: memoryview, names: Mapping[str, str]) -> Iterator[bytes]:
    """Give the fields of the graph with new names of values; its declared outputs keep theirs."""
    for number, value in fields(graph):
        if number == _NODE and isinstance(value, memoryview):
            yield encode_field(number, _rename_node(value, names))
        elif not (number == _VALUE_INFO and isinstance(value, memoryview) and _first_name(value) in names):
            yield encode_field(number, value)


def _rename_node(node: memoryview, names: Mapping[str, str]) -> bytes:
    parts = []
    for number, value in fields(node):
        if number == _NODE_ATTRIBUTE and isinstance(value, memoryview) and _has_subgraph(value):
            raise GraphRefused("it has a node with a graph of its own, which may read any value by name")
        if number in (_NODE_INPUT, _NODE_OUTPUT) and isinstance(value, memoryview):
            name = bytes(value).decode("utf-8", "replace")
            parts.append(encode_field(number, names.get(name, name)))
        else:
            parts.append(encode_field(number, value))
    return b"".join(parts)


def _has_subgraph(attribute: memoryview) -> bool:
    return any(number in _SUBGRAPHS for number, _ in fields(attribute))


def _first_name(entry: memoryview) -> str:
    names = (
        bytes(value)
        for number, value in fields(entry)
        if number == _FIRST_NAME and isinstance(value, memoryview)
    )
    return next(names, b"").decode("utf-8", "replace")


def _encode_additions(
    inputs: Mapping[str, Sequence[int]], operations: Sequence[Operation], constants: Mapping[str, float]
) -> Iterator[bytes]:
    for name, shape in inputs.items():
        yield encode_field(_INPUT, _float_input(name, shape))
    for name, value in constants.items():
        content = (1, 1), (2, _FLOAT), (8, name), (9, struct.pack("<f", value))
        yield encode_field(_INITIALIZER, message(*content))
    for operation in operations:
        yield from _node(operation)


def _float_input(name: str, shape: Sequence[int]) -> bytes:
    dims = b"".join(encode_field(1, message((1, size))) for size in shape)
    return message((1, name), (2, message((1, message((1, _FLOAT), (2, dims))))))


def _node(operation: Operation) -> Iterator[bytes]:
    inputs, content = operation.inputs, list[Field]()
    if operation.axes:
        axes = f"{operation.output}_axes"
        inputs = (*inputs, axes)
        data = b"".join(axis.to_bytes(8, "little", signed=True) for axis in operation.axes)
        yield encode_field(_INITIALIZER, message((1, len(operation.axes)), (2, _INT64), (8, axes), (9, data)))
        content = [
            (_NODE_ATTRIBUTE, message((1, "keepdims"), (3, int(operation.is_kept)), (20, _INT_ATTRIBUTE)))
        ]
    yield encode_field(
        _NODE,
        message(
            *((_NODE_INPUT, name) for name in inputs),
            (_NODE_OUTPUT, operation.output),
            (_NODE_NAME, f"appended {operation.kind} of {' and '.join(operation.inputs)}"),
            (_NODE_KIND, operation.kind),
            *content,
        ),
    )
