"""Cuts a trunk after the deepest tap that is used, because onnxruntime computes every output.

Trunks are cut at fit. A running gateway cuts one only for a bundle that was sent without its trunk: then, and then
alone, it imports onnx.
"""

from collections.abc import Sequence
from typing import Any

from edge.model.onnx_validation import GraphRefused, output_names

__all__ = ["cut_trunk", "prune"]


def cut_trunk(graph: bytes, taps: Sequence[str]) -> bytes:
    """Return the trunk up to the last of these taps in the order of its outputs; the outputs before it stay.

    So one backbone has at most as many cuts as taps, and parts that use the same deepest tap share one file. The bytes
    are unchanged where nothing can be cut or a tap is not among the outputs. Errors: GraphRefused for bytes that are
    not a model.
    """
    outputs = output_names(graph)
    if not taps or not set(taps) <= set(outputs):
        return graph
    last = max(outputs.index(tap) for tap in taps)
    if last + 1 == len(outputs):
        return graph
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load_from_string(graph)
    except DecodeError as error:
        raise GraphRefused(f"it is no ONNX model: {error}") from error
    del model.graph.output[last + 1 :]
    prune(model)
    return bytes(model.SerializeToString(deterministic=True))


def prune(model: Any) -> None:
    """Remove the nodes and weights that no output needs. Nodes are in the order of computation, as ONNX requires."""
    graph = model.graph
    needed = {output.name for output in graph.output}
    nodes = []
    for node in reversed(graph.node):
        if not needed.isdisjoint(node.output):
            nodes.append(node)
            needed.update(node.output, _read_by(node))
    kept = {
        "node": nodes[::-1],
        "initializer": [tensor for tensor in graph.initializer if tensor.name in needed],
        "value_info": [value for value in graph.value_info if value.name in needed],
        "quantization_annotation": [q for q in graph.quantization_annotation if q.tensor_name in needed],
    }
    for field, entries in kept.items():
        graph.ClearField(field)
        getattr(graph, field).extend(entries)


def _read_by(node: Any) -> set[str]:
    """The values that a node reads, those of its subgraphs included."""
    names = set(node.input)
    for attribute in node.attribute:
        for graph in (attribute.g, *attribute.graphs):
            names |= {name for inner in graph.node for name in _read_by(inner)}
            names |= {output.name for output in graph.output}
    return names
