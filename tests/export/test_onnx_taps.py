"""Any ONNX network with named values becomes a trunk that is cut after the last of them."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from command_line import ran
from graph_session import open_graph
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from export.backbone import BackboneOptions, export_backbone
from plugins.backbones.input_steps import IMAGENET, apply_steps
from plugins.onnx_builder import Graph

FRAMES = np.random.default_rng(0).integers(0, 256, (3, 32, 32, 3), dtype=np.uint8)
OWN = BackboneOptions("own", taps=("early=conv_3", "tokens=sequence"), frame=(32, 32))


def network(size: int | str = "h", tokens: int = 0, batch: int | str = "n") -> bytes:
    """A float network (n, 3, h, w) with a map `conv_3`, a sequence of patches (with tokens before it), and more."""
    rng = np.random.default_rng(1)
    g = Graph("theirs")
    x = g.input("image", (batch, 3, size, "w" if size == "h" else size))
    conv = g.op("Conv", x, g.constant(rng.normal(size=(4, 3, 8, 8)).astype(np.float32)), strides=[8, 8])
    flat = g.transpose(g.reshape(conv, 0, 4, -1), 0, 2, 1)
    if tokens:
        first = g.op("Slice", flat, g.ints(0), g.ints(tokens), g.ints(1))
        flat = g.op("Concat", first, flat, axis=1)
    g.output("sequence", flat, (batch, "l", 4))
    deep = g.op("MatMul", flat, g.constant(rng.normal(size=(4, 50_000)).astype(np.float32)))
    g.output("logits", deep, (batch, "l", 50_000))
    return g.serialise()


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    (tmp_path / "net.onnx").write_bytes(network())
    return tmp_path / "net.onnx"


def conv_name(data: bytes) -> str:
    return next(str(n.output[0]) for n in onnx.load_from_string(data).graph.node if n.op_type == "Conv")


def run(data: bytes, feeds: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    session = open_graph(data)
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, feeds), strict=True))


def taps(data: bytes) -> tuple[str, ...]:
    return f"early={conv_name(data)}", "tokens=sequence"


@pytest.mark.parametrize("tokens", [0, 1, 5])
def test_maps_stay_and_sequences_become_grids(saved: Path, tokens: int) -> None:
    """16 patches are 4x4, whatever tokens are before them; the wide last layer is not in the file."""
    saved.write_bytes(network(tokens=tokens))
    export = export_backbone(saved, None, dataclasses.replace(OWN, taps=taps(saved.read_bytes())))
    found = run(export.trunk, {"frames": FRAMES})
    expected = run(saved.read_bytes(), {"image": apply_steps(IMAGENET, FRAMES).astype(np.float32)})[
        "sequence"
    ]
    assert found.keys() == {"early", "tokens"}
    np.testing.assert_allclose(found["early"], found["tokens"], atol=1e-5)
    grid = expected[:, tokens:].transpose(0, 2, 1).reshape(3, 4, 4, 4)
    np.testing.assert_allclose(found["tokens"], grid, atol=1e-4)
    assert len(export.trunk) < 20_000 < len(saved.read_bytes())
    assert [result.name for result in export.parity.results] == ["input", "early", "tokens"]


def test_a_published_encoder_brings_its_steps(saved: Path) -> None:
    """UniT is read as any network, behind its own size and levels."""
    options = BackboneOptions("MIT", encoder="unit", taps=taps(saved.read_bytes())[:1])
    assert (
        "resize 128x160 without antialiasing" in export_backbone(saved, None, options).facts["preprocessing"]
    )


def test_a_fixed_size_and_one_frame_at_a_time(saved: Path) -> None:
    """Frames are resized to the network's size; a batch of one is taken as it is."""
    saved.write_bytes(network(24, batch=1))
    options = dataclasses.replace(OWN, taps=("sequence",), high=255.0)
    export = export_backbone(saved, None, options)
    assert run(export.trunk, {"frames": FRAMES[:1]})["sequence"].shape == (1, 4, 3, 3)
    assert "resize 24x24" in export.facts["preprocessing"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"taps": ("a=sequenze",)}, "has no value 'sequenze' for the tap 'a'; .*sequence"),
        ({"taps": ("logits", "logits")}, "taps are distinct values"),
        ({"taps": ()}, "taps are distinct values .* found none"),
        ({"taps": ("sequence",), "prefix_tokens": 3}, "16 tokens, and no square grid is left"),
        ({"licence": None}, "the licence of the weights in .* is not stated"),
    ],
)
def test_what_cannot_be_a_tap(saved: Path, change: dict[str, Any], words: str) -> None:
    """Unknown values get the nearest name; sequences that are no square grid are refused."""
    with pytest.raises(ConfigError, match=words):
        export_backbone(saved, None, dataclasses.replace(OWN, **change))


def test_weights_are_not_listed_as_taps(saved: Path) -> None:
    """torch hands weights on through nodes of their own; what does not depend on the picture cannot be a tap."""
    model = onnx.load_from_string(network())
    weight = model.graph.initializer[0].name
    model.graph.node.insert(0, onnx.helper.make_node("Identity", [weight], ["onnx::Conv_511"]))
    saved.write_bytes(model.SerializeToString())
    with pytest.raises(ConfigError, match="known: ") as refused:
        export_backbone(saved, None, dataclasses.replace(OWN, taps=("layer2",)))
    assert "onnx::Conv_511" not in str(refused.value)
    assert conv_name(saved.read_bytes()) in str(refused.value)


def test_the_command(saved: Path, tmp_path: Path) -> None:
    out, report = tmp_path / "t.onnx", tmp_path / "report"
    words = ("--taps", "layer1=sequence", "--licence", "MIT", "--report", report)
    assert "layer1" in ran("export", "backbone", saved, "-o", out, *words)
    assert (report / "parity.html").is_file()
    assert {p.key: p.value for p in onnx.load(out).metadata_props}["licence"] == "MIT"
