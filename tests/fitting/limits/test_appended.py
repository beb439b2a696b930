"""Operations appended to a graph."""

import numpy as np
import onnx.parser
import pytest
from graph_session import open_graph

from calibration.fitting.limits.appended import extend_head, head_inputs
from edge.core.errors import FitError
from edge.model.onnx_validation import check_graph
from plugins.onnx_builder import Graph


def doubling() -> bytes:
    """y = 2 x, and twice that as `score`, which reads y."""
    graph = Graph("doubling")
    x = graph.input("x", ("n", 2, 3))
    graph.output("y", graph.op("Add", x, x), ("n", 2, 3))
    graph.output("score", graph.op("ReduceMax", "y", graph.ints(1, 2), keepdims=0), ("n",))
    return graph.serialise()


def test_a_result_is_replaced_by_what_is_appended() -> None:
    """The old value has a new name for every node that reads it, and the output is the new one."""
    more = extend_head(doubling(), {"y": "old_y"}, {"factor": (1, 1)}, "y = Mul (old_y, factor)")
    check_graph(more)
    onnx.checker.check_model(onnx.load_from_string(more), full_check=True)
    x = np.ones((2, 2, 3), np.float32)
    y, score = open_graph(more).run(["y", "score"], {"x": x, "factor": np.full((1, 1), 5, np.float32)})
    assert y == pytest.approx(10 * x)
    assert score == pytest.approx([2, 2])  # it still reads the old value


def test_a_reduction_has_its_axes() -> None:
    """Each press has its own largest value. The inputs are named, those that were added too."""
    largest, axes = "score = ReduceMax <keepdims = 0> (x, axes)", "int64[2] axes = {1, 2}"
    more = extend_head(doubling(), {"score": "old"}, {"factor": (1, 1)}, largest, axes)
    x = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    fed = {"x": x, "factor": np.ones((1, 1), np.float32)}
    assert open_graph(more).run(["score"], fed)[0] == pytest.approx([5, 11])
    assert head_inputs(more) == ["x", "factor"]


def test_a_graph_inside_a_node_is_refused() -> None:
    """It may read a value by the old name."""
    model = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        g (bool is) => (float out) {
            out = If (is) <
                then_branch = a () => (float z) { z = Identity (y) },
                else_branch = b () => (float z) { z = Identity (y) }
            >
        }
    """).SerializeToString()
    with pytest.raises(FitError, match="a graph of its own"):
        extend_head(model, {"y": "old"}, {}, "")
