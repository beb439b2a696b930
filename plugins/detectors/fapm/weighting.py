"""What a press's largest distance is multiplied by: a softmax over the distances to a few neighbours.

Source: PatchCore's paper weights by the nearest neighbour's share; FAPM_official @5d2d2f2 by the largest. Defects of
the release, each a switch of its caller: exp overflows at 88, and a single neighbour has the share 1, the weight 0.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from plugins.onnx_builder import Graph, Value

__all__ = ["Weighting", "emit_first", "emit_weighted", "softmax_weight"]

Weighting = Literal["none", "largest", "nearest"]
"""none: the maximum of the map. largest: FAPM's weight, from the farthest of the neighbours. nearest: PatchCore's."""


def softmax_weight(
    neighbours: NDArray[np.float64], weighting: Weighting, is_stable: bool, is_bare: bool
) -> NDArray[np.float64]:
    """The factor (n,) of a press's largest distance from its neighbours' distances (n, k), rising.

    is_stable: the largest is subtracted before exp. is_bare: no weight.
    """
    if is_bare:
        return np.ones(len(neighbours))
    shifted = neighbours - neighbours.max(axis=1, keepdims=True) if is_stable else neighbours
    with np.errstate(over="ignore", invalid="ignore"):
        share = np.exp(shifted)
        share /= share.sum(axis=1, keepdims=True)
    weight: NDArray[np.float64] = 1 - (share.max(axis=1) if weighting == "largest" else share[:, 0])
    return weight


def emit_weighted(
    graph: Graph, neighbours: Value, weighting: Weighting, is_stable: bool, is_bare: bool
) -> Value:
    """The press's score (n,), weight included, from the distances (n, k) at its most anomalous place."""
    top = emit_first(graph, neighbours, 1)
    if is_bare:
        return top
    shifted = neighbours
    if is_stable:
        shifted = graph.op("Sub", neighbours, graph.op("ReduceMax", neighbours, graph.ints(1), keepdims=1))
    grown = graph.op("Exp", shifted)
    share = graph.op("Div", grown, graph.op("ReduceSum", grown, graph.ints(1), keepdims=1))
    if weighting == "largest":
        part = graph.op("ReduceMax", share, graph.ints(1), keepdims=0)
    else:
        part = emit_first(graph, share, 1)
    return graph.op("Mul", top, graph.op("Sub", graph.scalar(1.0), part))


def emit_first(graph: Graph, value: Value, axis: int) -> Value:
    """The first slice along an axis, the axis gone."""
    return graph.op("Squeeze", graph.op("Gather", value, graph.ints(0), axis=axis), graph.ints(axis))
