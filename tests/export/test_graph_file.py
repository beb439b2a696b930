"""A graph whose weights are in a file next to it is read as one piece; weights anywhere else are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from edge.core.errors import ConfigError
from edge.model.onnx_validation import check_graph
from export.graph_file import read_graph
from plugins.onnx_builder import Graph

WEIGHT = np.random.default_rng(0).normal(size=(40, 30)).astype(np.float32)


@pytest.fixture
def split(tmp_path: Path) -> Path:
    """As PyTorch's exporter writes it: model.onnx and model.onnx.data."""
    g = Graph("theirs")
    g.output("y", g.op("MatMul", g.input("x", ("n", 40)), g.constant(WEIGHT)), ("n", 30))
    path = tmp_path / "model.onnx"
    onnx.save(
        onnx.load_from_string(g.serialise()),
        path,
        save_as_external_data=True,
        location="model.onnx.data",
        size_threshold=0,
    )
    return path


def changed(path: Path, **facts: str) -> None:
    """Rewrite where the graph says that its weights are."""
    model = onnx.load(path, load_external_data=False)
    for entry in model.graph.initializer[0].external_data:
        entry.value = facts.get(entry.key, entry.value)
    path.write_bytes(model.SerializeToString())


def test_weights_next_to_the_graph_are_read_into_it(split: Path) -> None:
    """The result is one piece that a bundle may carry, with the same weights."""
    data = read_graph(split)
    check_graph(data)
    (weight,) = onnx.load_from_string(data).graph.initializer
    np.testing.assert_array_equal(numpy_helper.to_array(weight), WEIGHT)


def test_a_graph_in_one_piece_is_not_changed(tmp_path: Path) -> None:
    """Byte for byte, also where it is no graph at all: the sentence for that comes later."""
    for content in (b"", b"location", b"\x08\x08location"):
        (tmp_path / "g.onnx").write_bytes(content)
        assert read_graph(tmp_path / "g.onnx") == content


@pytest.mark.parametrize("location", ["../secret", "/etc/passwd", "a/b", "..", "", "a\\b"])
def test_weights_outside_the_folder_are_refused(split: Path, location: str) -> None:
    """No name leaves the graph's folder."""
    (split.parent.parent / "secret").write_bytes(bytes(10_000))
    changed(split, location=location)
    with pytest.raises(ConfigError, match="outside its own folder"):
        read_graph(split)


def test_a_link_is_not_followed(split: Path) -> None:
    """The file next to the graph is a plain one."""
    data = split.with_name("model.onnx.data")
    data.rename(split.with_name("elsewhere"))
    data.symlink_to(split.with_name("elsewhere"))
    with pytest.raises(ConfigError, match="which is not next to it; copy both files"):
        read_graph(split)


@pytest.mark.parametrize(
    "facts", [{"offset": "100000"}, {"length": "8"}, {"offset": "-4"}, {"length": "many"}]
)
def test_parts_that_do_not_fit_are_refused(split: Path, facts: dict[str, Any]) -> None:
    changed(split, **facts)
    with pytest.raises(ConfigError, match=r"the weight '.*' (needs 4800 bytes|has no known type)"):
        read_graph(split)


def test_a_missing_file_is_named(split: Path) -> None:
    split.with_name("model.onnx.data").unlink()
    with pytest.raises(ConfigError, match=r"in the file model\.onnx\.data, which is not next to it"):
        read_graph(split)
    with pytest.raises(ConfigError, match=r"none\.onnx cannot be read: No such file"):
        read_graph(split.with_name("none.onnx"))


def test_an_openvino_model_is_refused_with_the_next_step(tmp_path: Path) -> None:
    """Its graph is read by no ONNX program; the same training gives a file that is."""
    file = tmp_path / "model.xml"
    file.write_text('<?xml version="1.0"?>\n<net name="onnx_Frontend_IR" version="11">\n\t<layers>')
    with pytest.raises(ConfigError, match=r"model\.xml cannot be used: it is an OpenVINO model, .* as ONNX"):
        read_graph(file)
