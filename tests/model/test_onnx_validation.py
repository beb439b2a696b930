"""What an ONNX file may contain: standard operators on data inside the file."""

import contextlib
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
import pytest
import tiny
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.core.errors import BundleCorrupt
from edge.model.onnx_validation import GraphRefused, check_graph, output_names
from edge.model.session import open_session


def external(location: str) -> bytes:
    """A graph that adds a tensor kept in another file."""
    model = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        g (float[2] x) => (float[2] y) { y = Add (x, w) }
    """)
    tensor = onnx.TensorProto(name="w", data_type=onnx.TensorProto.FLOAT, dims=[2])
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location)
    model.graph.initializer.append(tensor)
    return model.SerializeToString()


def parsed(text: str) -> bytes:
    return onnx.parser.parse_model(text).SerializeToString()


def test_a_plain_graph_passes() -> None:
    """The trunks and heads that gelgate writes are accepted."""
    check_graph(tiny.tiny_trunk())
    check_graph(tiny.TINY.head(tiny.tiny_grid(), tiny.tiny_bank(), tiny.TinyParameters()))


def test_outputs_are_read_without_a_session() -> None:
    """The taps of a trunk, by name and in order."""
    assert output_names(tiny.tiny_trunk()) == ["layer1", "layer2"]


def test_external_data_is_refused_where_it_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A graph given as bytes would read files of the working directory; it is refused before it is parsed."""
    monkeypatch.chdir(tmp_path)
    Path("weights.bin").write_bytes(np.ones(2, np.float32).tobytes())
    with pytest.raises(GraphRefused, match="external file"):
        check_graph(external("weights.bin"))
    with pytest.raises(BundleCorrupt, match=r"head\.onnx is refused: it keeps tensors in an external file"):
        open_session(external("weights.bin"), 1, "head.onnx")


def test_external_data_is_found_inside_a_branch() -> None:
    """A constant in the branch of an If counts as well."""
    model = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        g (bool c) => (float[1] y)
        { y = If (c) <then_branch = a () => (float[1] p) { p = Constant <value = float[1] {1.0}> () },
                      else_branch = b () => (float[1] q) { q = Constant <value = float[1] {2.0}> () }> }
    """)
    inner = model.graph.node[0].attribute[0].g.node[0].attribute[0].t
    inner.data_location = onnx.TensorProto.EXTERNAL
    with pytest.raises(GraphRefused, match="external file"):
        check_graph(model.SerializeToString())


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            '< ir_version: 8, opset_import: ["" : 17, "com.microsoft" : 1] > g (float[2] x) => (float[2] y) '
            "{ y = com.microsoft.Gelu (x) }",
            "operator domain 'com.microsoft'",
        ),
        (
            '< ir_version: 8, opset_import: ["" : 17, "own" : 1] > g (float[2] x) => (float[2] y) { y = own.f (x) } '
            '< domain: "own", opset_import: ["" : 17] > f (a) => (b) { b = Relu (a) }',
            "operator domain 'own'|functions of its own",
        ),
    ],
)
def test_foreign_operators_are_refused(text: str, reason: str) -> None:
    """Only the standard domain runs everywhere; custom code never loads."""
    with pytest.raises(GraphRefused, match=reason):
        check_graph(parsed(text))


@pytest.mark.parametrize("data", [b"", b"\x00" * 40, b"PK\x03\x04 not a model", b"\xff" * 100])
def test_bytes_that_are_no_model_are_refused(data: bytes) -> None:
    with pytest.raises(GraphRefused):
        check_graph(data)


@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=4))
@settings(max_examples=80, deadline=None)
def test_a_damaged_model_is_refused_or_still_standard(at: int, junk: bytes) -> None:
    """Whatever bytes are overwritten, the check ends: it accepts or says GraphRefused."""
    data = bytearray(tiny.tiny_trunk())
    at %= len(data)
    data[at : at + len(junk)] = junk
    with contextlib.suppress(GraphRefused):
        check_graph(bytes(data))


def test_nesting_is_bounded() -> None:
    """A graph inside a graph inside a graph ... is refused instead of exhausting the stack."""

    def message(number: int, body: bytes) -> bytes:
        size, digits = len(body), b""
        while size >= 0x80:
            digits += bytes([size & 0x7F | 0x80])
            size >>= 7
        return bytes([number << 3 | 2]) + digits + bytes([size]) + body

    graph = b""
    for _ in range(3000):
        graph = message(1, message(5, message(6, graph)))
    with pytest.raises(GraphRefused, match="nested"):
        check_graph(message(7, graph))
