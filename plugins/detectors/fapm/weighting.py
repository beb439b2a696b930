"""The factor of a press's largest distance: a softmax over the distances to a few neighbours.

Source: PatchCore's paper weights by the nearest neighbour's share; FAPM_official @5d2d2f2 by the largest.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from plugins.onnx_builder import Graph, Value

__all__ = [
    "Weighting",
    "emit_first",
    "emit_minus_largest",
    "emit_softmax_weight",
    "minus_largest",
    "softmax_weight",
]

Weighting = Literal["none", "largest", "nearest"]
"""none: the maximum of the map. largest: FAPM's weight, from the farthest of the neighbours. nearest: PatchCore's."""


def minus_largest(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances (n, k) minus the largest of each row, so that no exp overflows."""
    shifted: NDArray[np.float64] = distances - distances.max(axis=1, keepdims=True)
    return shifted


def emit_minus_largest(graph: Graph, distances: Value) -> Value:
    """Do the same in a graph."""
    return graph.op("Sub", distances, graph.op("ReduceMax", distances, graph.ints(1), keepdims=1))


def softmax_weight(shifted: NDArray[np.float64], weighting: Weighting) -> NDArray[np.float64]:
    """The factor (n,) of a press's largest distance, from its neighbours' shifted distances (n, k), rising."""
    with np.errstate(over="ignore", invalid="ignore"):
        share = np.exp(shifted)
        share /= share.sum(axis=1, keepdims=True)
    weight: NDArray[np.float64] = 1 - (share.max(axis=1) if weighting == "largest" else share[:, 0])
    return weight


def emit_softmax_weight(graph: Graph, shifted: Value, weighting: Weighting) -> Value:
    """Do the same in a graph."""
    grown = graph.op("Exp", shifted)
    share = graph.op("Div", grown, graph.op("ReduceSum", grown, graph.ints(1), keepdims=1))
    if weighting == "largest":
        part = graph.op("ReduceMax", share, graph.ints(1), keepdims=0)
    else:
        part = emit_first(graph, share, 1)
    return graph.op("Sub", graph.scalar(1.0), part)


def emit_first(graph: Graph, value: Value, axis: int) -> Value:
    """The first slice along an axis, without that axis."""
    return graph.op("Squeeze", graph.op("Gather", value, graph.ints(0), axis=axis), graph.ints(axis))
