"""Nearest rows in many small groups at once, or in one large bank: a product makes the shortlist, differences decide.

`distances.py` searches one bank. Here every group of queries has its own bank (a block of cells, a press's gallery, a
cell of the grid), and all groups are in one batched product. The rules are the same. Both sides are centred, and
squared distances are never negative. The nearest rows are computed again as a sum of squared differences, as plain
(not squared) distances. Among equals the lowest row wins (ONNX TopK keeps the lower index).
"""

from plugins.onnx_builder import Graph, Value

__all__ = [
    "PRODUCT_LIMIT",
    "SHORTLIST",
    "HalvedBank",
    "emit_closest",
    "emit_group_nearest",
    "emit_range",
    "emit_ranked",
]

# Rows measured exactly for each query.
SHORTLIST = 4
# Distances that one product may hold, which limits the rows at a time in a large bank (64 MB of float32).
PRODUCT_LIMIT = 16 * 2**20
# Rows that one maximum is taken over before the index of the greatest is computed.
RUN = 32


def emit_ranked(graph: Graph, bank: Value) -> Value:
    """Rows (..., m, width) with one more number, -|row|^2/2, so that a product with (query, 1) ranks by distance."""
    squares = graph.op("ReduceSum", graph.op("Mul", bank, bank), graph.ints(-1), keepdims=0)
    penalty = graph.unsqueeze(graph.op("Mul", squares, graph.scalar(-0.5)), -1)
    return graph.op("Concat", bank, penalty, axis=-1)


def emit_group_nearest(
    graph: Graph, queries: Value, ranked: Value, width: int, k: int = 1, shortlist: int = SHORTLIST
) -> Value:
    """Plain distances (g, q, min(k, m)), rising, from queries (g, q, width) to rows of their own bank.

    ranked: (g, m, width + 1), from `emit_ranked`. Both are float32, with the same centre.
    """
    rows_there = graph.op("Shape", ranked, start=1, end=2)
    padded = graph.op("Pad", queries, graph.ints(0, 0, 0, 0, 0, 1), graph.scalar(1.0))
    closeness = graph.op("MatMul", padded, graph.transpose(ranked, 0, 2, 1))
    _, rows = graph.ops("TopK", 2, closeness, graph.op("Min", graph.ints(shortlist), rows_there), axis=2)
    chosen = graph.op("GatherND", ranked, graph.reshape(rows, 0, -1, 1), batch_dims=1)
    chosen = graph.slice(chosen, 0, width, 2)
    shape = graph.op("Concat", graph.op("Shape", rows), graph.ints(width), axis=0)
    difference = graph.op("Sub", graph.op("Reshape", chosen, shape), graph.unsqueeze(queries, 2))
    exact = graph.op("ReduceSum", graph.op("Mul", difference, difference), graph.ints(3), keepdims=0)
    if k == 1:
        nearest = graph.op("ReduceMin", exact, graph.ints(2), keepdims=1)
    else:
        nearest, _ = graph.ops(
            "TopK", 2, exact, graph.op("Min", graph.ints(k), rows_there), axis=2, largest=0
        )
    return graph.op("Sqrt", nearest)


def emit_closest(graph: Graph, queries: Value, bank: Value, width: int) -> Value:
    """Plain distances (n, g, q) from queries (n, g, q, width) to the closest row of their group's bank (g, m, width).

    The product chooses one row, whose distance is computed again. That is right where close rows differ much, as
    prototypes picked by k-centre do: a row that is wrong within rounding then has a distance right within rounding.
    Several times faster than a shortlist.
    """
    squares = graph.op("ReduceSumSquare", bank, graph.ints(2), keepdims=0)
    half = graph.unsqueeze(graph.op("Mul", squares, graph.scalar(0.5)), 1)
    closeness = graph.op("Sub", graph.op("MatMul", queries, graph.transpose(bank, 0, 2, 1)), half)
    best = graph.op("ArgMax", closeness, axis=3, keepdims=0)
    groups, rows = (graph.op("Shape", bank, start=axis, end=axis + 1) for axis in (0, 1))
    first = graph.op("Mul", emit_range(graph, groups), rows)
    flat = graph.op("Add", best, graph.unsqueeze(first, 1))
    chosen = graph.op("Gather", graph.reshape(bank, -1, width), flat, axis=0)
    difference = graph.op("Sub", queries, chosen)
    return graph.length(difference, 3)


class HalvedBank:
    """One bank for all queries, each of which is compared with the closest row of each half.

    If the product picks a wrong row of a half, the distance is off by the root of the product's rounding, 3e-4 of the
    centred length at most. Rows picked by k-centre differ by far more. The greatest of a run of rows is computed first,
    its index last. onnxruntime finds maxima in a tenth of the time of their indices (3136 queries in 1024 rows, two
    cores: 0.4 ms, and 0.9 for the two best by TopK).

    Twice the nodes give the same distances in nine tenths of the processor time: a product over 32 of 64 directions,
    which bounds the distance from below, and the complete search again for the queries that the bound leaves open (8 %;
    a fifth with 24 directions). That is too little for a second search to be right in.
    """

    def __init__(self, graph: Graph, bank: Value) -> None:
        """bank: (m, width), centred like the queries; repeated from its start until it fills pairs of runs."""
        self.graph = graph
        rows, block = graph.op("Shape", bank, start=0, end=1), graph.ints(2 * RUN)
        blocks = graph.op("Div", graph.op("Add", rows, graph.ints(2 * RUN - 1)), block)
        self.runs, self.count = blocks, graph.op("Mul", blocks, block)
        self.rows = graph.op("Gather", bank, graph.op("Mod", emit_range(graph, self.count), rows), axis=0)
        self.ranked = graph.transpose(emit_ranked(graph, self.rows), 1, 0)

    def nearest(self, queries: Value) -> Value:
        """Plain distances (q,) of queries (q, width)."""
        graph = self.graph
        padded = graph.op("Pad", queries, graph.ints(0, 0, 0, 1), graph.scalar(1.0))
        runs = graph.reshape(graph.op("MatMul", padded, self.ranked), -1, RUN)
        # (2q, runs): a row for each half of the bank.
        halves = graph.op("Concat", graph.ints(-1), self.runs, axis=0)
        tops = graph.op("Reshape", graph.op("ReduceMax", runs, graph.ints(1), keepdims=0), halves)
        best = graph.op("ArgMax", tops, axis=1, keepdims=0)
        first = graph.op("Mul", emit_range(graph, graph.op("Shape", best)), self.runs)
        run = graph.op("Add", best, first)
        place = graph.op("ArgMax", graph.op("Gather", runs, run, axis=0), axis=1, keepdims=0)
        row = graph.op("Mod", graph.op("Add", graph.op("Mul", run, graph.ints(RUN)), place), self.count)
        chosen = graph.op("Gather", self.rows, graph.reshape(row, -1, 2), axis=0)
        difference = graph.op("Sub", chosen, graph.unsqueeze(queries, 1))
        exact = graph.op("ReduceSumSquare", difference, graph.ints(2), keepdims=0)
        return graph.op("Sqrt", graph.op("ReduceMin", exact, graph.ints(1), keepdims=0))

    def search(self, rows: Value, size: tuple[int, int], step: int) -> Value:
        """Plain distances (n, cells) of rows (n, cells, width), so many cells at a time. size: cells, width."""
        graph, (cells, width) = self.graph, size
        parts = []
        for first in range(0, cells, max(1, step)):
            count = min(max(1, step), cells - first)
            asked = rows if count == cells else graph.slice(rows, first, first + count, 1)
            parts.append(graph.reshape(self.nearest(graph.reshape(asked, -1, width)), -1, count))
        return graph.concat(parts, 1)


def emit_range(graph: Graph, count: Value) -> Value:
    """0, 1, ... up to a count in a vector of length one."""
    start, step = (graph.op("Squeeze", graph.ints(number)) for number in (0, 1))
    return graph.op("Range", start, graph.op("Squeeze", count), step)
