"""Any trunk is cut after the last tap that the detector reads."""

import hashlib

import numpy as np
import onnx.checker
import onnx.parser
import pytest
from graph_session import open_graph

from calibration.fitting.trunks import open_trunk
from edge import registry
from edge.model.graph_cut import cut_trunk
from edge.model.onnx_validation import GraphRefused, output_names
from plugins.backbones.tactile import tactile_resnet18
from plugins.onnx_builder import Graph

FRAMES = np.random.default_rng(0).integers(0, 256, (1, 64, 64, 3), dtype=np.uint8)


def run(graph: bytes, tap: str) -> np.ndarray:
    session = open_graph(graph)
    answer: np.ndarray = session.run([tap], {"frames": FRAMES})[0]
    return answer


@pytest.mark.parametrize("backbone", ["tactile_resnet18", "tactile_resnet18_int8"])
def test_a_cut_trunk_gives_the_same_features(backbone: str) -> None:
    """Cut after layer1 both variants give its features bit for bit, in less than a tenth of the bytes."""
    whole, cut = open_trunk(backbone), open_trunk(backbone, ("layer1",))
    onnx.checker.check_model(onnx.load_from_string(cut.graph), full_check=True)
    assert output_names(cut.graph) == ["layer1"]
    assert cut.facts["cut_after"] == "layer1"
    assert len(cut.graph) < len(whole.graph) / 10
    assert np.array_equal(run(cut.graph, "layer1"), run(whole.graph, "layer1"))


def test_parts_that_read_equally_deep_share_one_file() -> None:
    """layer2 alone and layer1 with layer2 are one cut; all three taps are the unchanged file."""
    whole = tactile_resnet18.trunk()
    assert cut_trunk(whole, ("layer2",)) == cut_trunk(whole, ("layer1", "layer2"))
    for taps in ((), ("layer3",), ("layer1", "layer3"), ("layer1", "layer4")):
        assert cut_trunk(whole, taps) is whole


def test_what_is_no_model_is_refused() -> None:
    with pytest.raises(GraphRefused):
        cut_trunk(b"\xff" * 40, ("layer1",))


def test_what_a_subgraph_reads_stays() -> None:
    """A graph inside a node reads values of the graph around it by their names."""
    nested = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        nested (float[n] x, bool c) => (float[n] second, float[n] third)
        {
            first = Abs (x)
            second = If (c) <
                then_branch = yes () => (float[n] a) { a = Neg (first) },
                else_branch = no () => (float[n] b) { b = Identity (first) }
            >
            third = Neg (second)
        }
    """).SerializeToString()
    cut = onnx.load_from_string(cut_trunk(nested, ("second",)))
    onnx.checker.check_model(cut, full_check=True)
    assert [node.op_type for node in cut.graph.node] == ["Abs", "If"]


# The cut trunks that bundles of 0.1.0 and 0.2.0 name, by the installed backbone and the last tap.
KNOWN_CUTS = {
    ("tactile_lite0", "layer1"): "6d1234cc5f17d49b",
    ("tactile_lite0", "layer2"): "df03e584e736a19f",
    ("tactile_resnet18", "layer1"): "5aa132f75d172451",
    ("tactile_resnet18", "layer2"): "e7f9ef8025fd21f9",
    ("tactile_resnet18_int8", "layer1"): "8ed2a632a4dbfef6",
    ("tactile_resnet18_int8", "layer2"): "ab79253d360cbb83",
}


@pytest.mark.parametrize(("backbone", "tap"), KNOWN_CUTS)
def test_bundles_sent_without_their_trunk_find_the_same_bytes(backbone: str, tap: str) -> None:
    """The manifest of such a bundle names the cut's SHA-256; other bytes would be refused."""
    cut = cut_trunk(registry.backbone(backbone).trunk(), (tap,))
    assert hashlib.sha256(cut).hexdigest()[:16] == KNOWN_CUTS[backbone, tap]


def test_a_trunk_of_any_origin_is_cut() -> None:
    """Weights, inputs and metadata that stay keep their bytes; what only the removed nodes used is removed."""
    graph = Graph("two")
    x = graph.op("Cast", graph.input("frames", ("n", "h", "w", 3), "uint8"), to=1)
    shallow = graph.op("Mul", x, graph.constant(np.full((3,), 2.0, np.float32)))
    deep = graph.op("Add", shallow, graph.constant(np.arange(300, dtype=np.float32).reshape(100, 1, 3)))
    graph.output("shallow", shallow, ("n", "h", "w", 3))
    graph.output("deep", deep, ("n", 100, "w", 3))
    cut = onnx.load_from_string(cut_trunk(graph.serialise({"kept": "yes"}), ("shallow",)))
    assert [node.op_type for node in cut.graph.node] == ["Cast", "Mul", "Identity"]
    assert [tuple(t.dims) for t in cut.graph.initializer] == [(3,)]
    assert [(p.key, p.value) for p in cut.metadata_props] == [("kept", "yes")]
