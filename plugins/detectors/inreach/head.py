"""InReaCh's graph: the distance of each descriptor to its nearest row of the bank."""

from edge.core.detector import Bank, Grid
from plugins.detectors.common.smoothing import emit_scores
from plugins.detectors.inreach.parameters import InreachParameters
from plugins.onnx_builder import Graph

__all__ = ["inreach_head"]


def inreach_head(name: str, grid: Grid, bank: Bank, p: InreachParameters) -> bytes:
    """The serialised head of a bank; the number of rows is free."""
    graph = Graph(name)
    emit_scores(graph, p.rows.emit(graph, grid, bank, p.is_squared), p.smoothing(grid))
    return graph.serialise()
