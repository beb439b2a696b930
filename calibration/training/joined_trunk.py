"""Makes `tactile_lite0.onnx`: the first block of the tactile trunk and EfficientNet-Lite0 in one graph.

    python3 -m calibration.training.joined_trunk FOLDER

layer1 has the 64 channels of a tactile trunk's first residual block, then the 24 of EfficientNet-Lite0; layer2 and
layer3 are EfficientNet-Lite0's alone. Nothing is trained here. The same two files give the same bytes. The tactile
part is that of the trunk that ships, which alone still holds it: it was learnt in 4,000 steps, before
`tactile_resnet18` got its present weights (docs/backbone.md). The weights of EfficientNet-Lite0 are those of the extra
`comparison`; both are under Apache-2.0 (docs/licences.md).
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import GelgateError
from plugins.backbones.efficientnet_lite0 import SHA256, State, installed_weights, lite0_taps
from plugins.backbones.input_steps import IMAGENET, input_planes
from plugins.backbones.tactile_lite0 import tactile_lite0
from plugins.onnx_builder import Graph, Value

if TYPE_CHECKING:
    import onnx

__all__ = ["TACTILE_SCALE", "build_tactile_lite0", "main"]

TACTILE_SCALE = 2.58
"""Of the tactile channels of layer1. On simulated presses their deviation, over all channels, is 5.8 and that of
EfficientNet-Lite0's is 30; with this factor the latter count twice as much."""

_TACTILE_CHANNELS, _LITE0_CHANNELS = 64, 24
_FORMAT = 1

Conv = tuple["onnx.NodeProto", NDArray[np.floating], NDArray[np.float32]]


def build_tactile_lite0(tactile: bytes, lite0: State) -> bytes:
    """The serialised trunk: `frames` uint8 RGB (n, h, w, 3) to layer1, layer2 and layer3 at strides 4, 8 and 16.

    tactile: a graph whose first convolutions are a tactile trunk's stem and first residual block. lite0: weights of
    EfficientNet-Lite0.
    """
    graph = Graph(tactile_lite0.name)
    felt = _first_block(graph, input_planes(graph, IMAGENET), list(_convolutions(tactile)))
    felt = graph.op("Mul", felt, graph.scalar(TACTILE_SCALE))
    for tap, (value, channels) in lite0_taps(graph, lite0, "frames"):
        if tap == "layer1":
            value, channels = graph.op("Concat", felt, value, axis=1), _TACTILE_CHANNELS + channels
        graph.output(tap, value, ("n", channels, f"{tap}_h", f"{tap}_w"))
    return graph.serialise({"topology": tactile_lite0.name, "licence": "Apache-2.0"})


def _convolutions(tactile: bytes) -> Iterator[Conv]:
    """Yield the convolutions of stem and first block in their order: node, weights as stored, bias."""
    import onnx
    from onnx import numpy_helper

    model = onnx.load_from_string(tactile).graph
    stored = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.initializer}
    widened = {node.output[0]: node.input[0] for node in model.node if node.op_type == "Cast"}
    found = [node for node in model.node if node.op_type == "Conv"][:3]
    for node in found:
        weight, bias = node.input[1:]
        yield node, stored[widened.get(weight, weight)], stored[bias]


def _first_block(graph: Graph, x: Value, convolutions: Sequence[Conv]) -> Value:
    """Append ResNet's stem and first block; weights stay in the precision in which they are stored."""
    stem, first, second = convolutions
    x = graph.op("Relu", _conv(graph, x, stem))
    x = graph.op("MaxPool", x, kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1])
    inner = graph.op("Relu", _conv(graph, x, first))
    return graph.op("Relu", graph.op("Add", _conv(graph, inner, second), x))


def _conv(graph: Graph, x: Value, conv: Conv) -> Value:
    from onnx import helper

    node, weight, bias = conv
    settings = {one.name: helper.get_attribute_value(one) for one in node.attribute}
    stored = graph.op("Cast", graph.constant(weight), to=1)
    return graph.op("Conv", x, stored, graph.constant(bias), **settings)


def main(words: Sequence[str] | None = None) -> int:
    """Write the trunk and its facts into a folder; 0 when done, else the sentence and 3."""
    parser = argparse.ArgumentParser(
        prog="calibration.training.joined_trunk", description="Write tactile_lite0.onnx and its facts."
    )
    parser.add_argument("folder", type=Path, help="output folder")
    folder = parser.parse_args(words).folder
    try:
        tactile = tactile_lite0.trunk()
        graph = build_tactile_lite0(tactile, installed_weights())
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{tactile_lite0.name}.onnx").write_bytes(graph)
        facts = json.dumps(_facts_of(graph, tactile), indent=2)
        (folder / f"{tactile_lite0.name}.json").write_text(facts + "\n")
    except (GelgateError, OSError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0


def _facts_of(graph: bytes, tactile: bytes) -> dict[str, Any]:
    """Return what is stored with the trunk: its size and hash, and what it was made of."""
    digest = hashlib.sha256()
    for _, weight, bias in _convolutions(tactile):
        digest.update(weight.tobytes())
        digest.update(bias.tobytes())
    return {
        "format": _FORMAT,
        "name": tactile_lite0.name,
        "bytes": len(graph),
        "sha256": hashlib.sha256(graph).hexdigest(),
        "channels": {"tactile": _TACTILE_CHANNELS, "efficientnet_lite0": _LITE0_CHANNELS},
        "made_of": {"tactile": digest.hexdigest(), "efficientnet_lite0": SHA256},
        "licence": "Apache-2.0",
        "blocks": 1,
        "tactile_scale": TACTILE_SCALE,
    }


if __name__ == "__main__":
    sys.exit(main())
