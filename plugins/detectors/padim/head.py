"""PaDiM's graph: descriptors minus their means, and the two terms of their Mahalanobis distance."""

from edge.core.detector import Bank, Grid
from plugins.detectors.common.embedding import Embedding
from plugins.detectors.common.smoothing import emit_scores
from plugins.detectors.padim.parameters import PadimParameters
from plugins.onnx_builder import Graph, Value

__all__ = ["emit_squared", "padim_head"]


def padim_head(name: str, grid: Grid, bank: Bank, parameters: PadimParameters) -> bytes:
    """The serialised head of a bank; the number of directions is free."""
    arrays, embedding = bank.arrays, Embedding(parameters, grid, bank.arrays)
    graph = Graph(name)
    count, width = embedding.count, embedding.width
    delta = graph.op("Sub", embedding.emit(graph), graph.input("mean", (count, width)))
    basis, weights = (
        graph.input("basis", ("blocks", "rank", width)),
        graph.input("weights", ("blocks", "rank")),
    )
    here = delta
    if "locations" in arrays:
        here = graph.op("Gather", delta, graph.input("locations", ("located",), "int64"), axis=1)
    squared = emit_squared(graph, here, basis, weights, parameters.block**2, parameters.total_ridge)
    if "elsewhere" in arrays:
        shared = (
            graph.input("shared_basis", ("directions", width)),
            graph.input("shared_weights", ("directions",)),
        )
        there = graph.op("Gather", delta, graph.input("elsewhere", ("elsewhere",), "int64"), axis=1)
        rest = _squared_shared(graph, there, *shared, parameters.total_ridge)
        squared = graph.op("Concat", squared, rest, axis=1)
    if "order" in arrays:
        squared = graph.op("Gather", squared, graph.input("order", (count,), "int64"), axis=1)
    raw = graph.reshape(graph.op("Sqrt", squared), -1, *embedding.cells)
    emit_scores(graph, raw, parameters.smoothing(grid, embedding.cells))
    return graph.serialise()


def emit_squared(graph: Graph, delta: Value, basis: Value, weights: Value, count: int, ridge: float) -> Value:
    """Squared distances (n, m * count) of delta (n, m * count, d): each block of `count` cells under its own basis
    (m, r, d) and weights (m, r).

    One small matrix product per press and block for every n: so a press has the same score alone and in a batch.
    """
    shape = graph.op("Concat", graph.ints(0, -1, count), graph.op("Shape", basis, start=2), axis=0)
    rows = graph.op("Reshape", delta, shape)
    along = graph.op("MatMul", rows, graph.transpose(basis, 0, 2, 1))
    off = graph.op("Sub", rows, graph.op("MatMul", along, basis))
    squared = _sum(graph, along, graph.unsqueeze(weights, 1), off, ridge, 3)
    return graph.reshape(squared, 0, -1)


def _squared_shared(graph: Graph, delta: Value, basis: Value, weights: Value, ridge: float) -> Value:
    """Give the same under one basis (r, d) and weights (r,) for all locations."""
    along = graph.op("MatMul", delta, graph.transpose(basis, 1, 0))
    off = graph.op("Sub", delta, graph.op("MatMul", along, basis))
    return _sum(graph, along, weights, off, ridge, 2)


def _sum(graph: Graph, along: Value, weights: Value, off: Value, ridge: float, *axes: int) -> Value:
    """Weighted squares on the span plus squares off it by the ridge: never negative; inf and NaN stay."""
    weighted = graph.op("Mul", graph.op("Mul", along, along), weights)
    inside = graph.op("ReduceSum", weighted, graph.ints(*axes), keepdims=0)
    outside = graph.op("ReduceSumSquare", off, graph.ints(*axes), keepdims=0)
    return graph.op("Add", inside, graph.op("Mul", outside, graph.scalar(1 / ridge)))
