"""The floor of a point: the least time that its arithmetic and its bytes can take on a machine of known peak.

Counted are convolutions and matrix products, and the bytes that have to be moved at least once: frame, weights, bank
and score map. Everything else (activations between layers, element-wise work, decoding) comes on top, so no
implementation of the same graphs can be faster.

Ref: Williams, Waterman, Patterson, "Roofline: an insightful visual performance model", CACM 52 (2009).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calibration.experiments.tradeoff.machine import Peak
from edge.model.bundle import Bundle

__all__ = ["Work", "floor_ms", "operations", "see_at_once", "trunk_work", "work_of"]


@dataclass(frozen=True)
class Work:
    """What one press needs at least: operations in float32 and in int8, and bytes moved."""

    float32: float
    int8: float
    bytes: float


def floor_ms(work: Work, peak: Peak) -> tuple[float, str]:
    """The least milliseconds, and which of the two limits: arithmetic or bandwidth."""
    arithmetic = 1e3 * (work.float32 / peak.float32_per_s + work.int8 / peak.int8_per_s)
    moving = 1e3 * work.bytes / peak.bytes_per_s
    return max(arithmetic, moving), "arithmetic" if arithmetic >= moving else "bandwidth"


def work_of(trunk: bytes, bundle: Bundle) -> Work:
    """Return the work of one press by a bundle with this trunk and a head."""
    grid, head, first = bundle.grid, bundle.graphs.head, trunk_work(trunk, bundle)
    assert grid is not None
    assert head is not None
    shapes = {tap: (1, *shape) for tap, shape in grid.taps.items()}
    head_ops, _ = operations(head, {**shapes, **{name: array.shape for name, array in bundle.bank.items()}})
    moved = sum(array.nbytes for array in bundle.bank.values()) + math.prod(grid.frame) * 4
    return Work(first.float32 + head_ops, first.int8, first.bytes + moved)


def trunk_work(trunk: bytes, bundle: Bundle) -> Work:
    """Return the work of the trunk on one press."""
    grid = bundle.grid
    assert grid is not None
    tiles = 1 if grid.tiles is None else len(grid.tiles)
    count, is_int8 = operations(trunk, {"frames": (1, *see_at_once(bundle), 3)})
    moved = len(trunk) + math.prod(grid.frame) * 3
    return Work(0, count * tiles, moved) if is_int8 else Work(count * tiles, 0, moved)


def see_at_once(bundle: Bundle) -> tuple[int, int]:
    """Return rows and columns of what the trunk sees at once."""
    assert bundle.grid is not None
    tiles = bundle.grid.tiles
    return bundle.grid.frame if tiles is None else (tiles.size, tiles.size)


def operations(graph: bytes, inputs: Mapping[str, tuple[int, ...]]) -> tuple[float, bool]:
    """Operations in convolutions and products of a graph for these input shapes, and whether weights are int8.

    A node whose shapes cannot be inferred counts as nothing: the floor stays a floor.
    """
    import onnx

    model = onnx.load_from_string(graph)
    for given in model.graph.input:
        if given.name in inputs:
            del given.type.tensor_type.shape.dim[:]
            for size in inputs[given.name]:
                given.type.tensor_type.shape.dim.add().dim_value = size
    for output in model.graph.output:
        output.type.tensor_type.ClearField("shape")
    del model.graph.value_info[:]
    shapes = _shapes(onnx.shape_inference.infer_shapes(model, data_prop=True))
    is_int8 = any("Quantize" in node.op_type or "QLinear" in node.op_type for node in model.graph.node)
    return sum(_of_node(node, shapes) for node in model.graph.node), is_int8


def _shapes(model: Any) -> dict[str, tuple[int, ...]]:
    """Every tensor of known shape."""
    known = {tensor.name: tuple(tensor.dims) for tensor in model.graph.initializer}
    for value in (*model.graph.value_info, *model.graph.input, *model.graph.output):
        dims = value.type.tensor_type.shape.dim
        if value.type.tensor_type.HasField("shape") and all(d.HasField("dim_value") for d in dims):
            known[value.name] = tuple(d.dim_value for d in dims)
    return known


def _of_node(node: Any, shapes: Mapping[str, tuple[int, ...]]) -> float:
    result = shapes.get(node.output[0])
    if result is None:
        return 0.0
    match node.op_type:
        case "Conv" | "ConvInteger":
            weight = shapes.get(node.input[1])
        case "QLinearConv":
            weight = shapes.get(node.input[3])
        case "MatMul" | "MatMulInteger" | "Gemm":
            left = shapes.get(node.input[0])
            turned = node.op_type == "Gemm" and any(a.name == "transA" and a.i for a in node.attribute)
            return 0.0 if left is None else 2.0 * math.prod(result) * left[0 if turned else -1]
        case _:
            return 0.0
    # Multiply-adds of one output value: the weights of its channel.
    return 0.0 if weight is None else 2.0 * math.prod(result) * math.prod(weight[1:])
