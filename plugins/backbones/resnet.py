"""`build_trunk`: a state dict in torchvision's naming becomes an ONNX graph from frames to named feature maps.

Batch norm is folded into the convolutions in float64. The normalisation of the pixels stays a separate operation:
folded into the first convolution it would be wrong at the border, where the padding is zero *after* normalising. The
graph ends at the last tap that is requested.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64
from edge.core.errors import ConfigError
from plugins.backbones.input_steps import IMAGENET, InputSteps, input_planes
from plugins.backbones.topology import Conv, State, Topology, check_state, last_block, topology
from plugins.onnx_builder import Graph, Value

__all__ = ["NORM_EPS", "TAPS", "build_trunk", "folded", "store_weights"]

# torch.nn.BatchNorm2d's default; a state dict does not carry it.
NORM_EPS = 1e-5
# What PaDiM, FAPM and PatchCore read.
TAPS = ("layer1", "layer2", "layer3")


def build_trunk(
    state: State,
    topology_name: str,
    taps: Sequence[str] = TAPS,
    *,
    steps: InputSteps = IMAGENET,
    frame: tuple[int, int] | None = None,
    weights: Literal["float32", "float16"] = "float32",
    facts: Mapping[str, str] | None = None,
) -> bytes:
    """The trunk as serialised ONNX.

    Input `frames` uint8 RGB (n, h, w, 3) of any size from 32x32 on; one output float32 (n, c, h', w') per tap, named as
    the tap (a stage `layer2`, a block `layer4.0`, or `avgpool`). frame: (h, w) where it is fixed, as these steps may
    need. weights: how they are stored; float16 halves the file and is widened once when the graph is loaded. facts:
    further entries for the graph's metadata, which always has topology, mean and std.

    Errors: ConfigError for an unknown topology or tap, weights that are not this network's, or no tap at all.
    """
    net = topology(topology_name)
    if not taps or len(set(taps)) != len(taps):
        raise ConfigError(f"a trunk needs distinct taps, found {list(taps)}; for instance {', '.join(TAPS)}")
    wanted = {tap: last_block(net, tap) for tap in taps}
    check_state(state, net, until=taps)
    builder = _TrunkBuilder(net, state, weights)
    outputs = builder.run(input_planes(builder.graph, steps, frame), set(wanted.values()))
    for tap, block in wanted.items():
        value, channels = outputs[block]
        size: tuple[int | str, int | str] = (1, 1) if tap == "avgpool" else (f"{tap}_h", f"{tap}_w")
        builder.graph.output(tap, value, ("n", channels, *size))
    if steps.copies != 1:
        raise ConfigError(
            f"{net.name} reads three channels, the steps give {3 * steps.copies}; use one frame"
        )
    colours = {"mean": ",".join(map(str, steps.mean)), "std": ",".join(map(str, steps.std))}
    if (steps.background, steps.size) != (None, None):
        colours["preprocessing"] = steps.words
    return builder.graph.serialise({"topology": topology_name, **colours, **(facts or {})})


def folded(state: State, conv: str, norm: str, eps: float = NORM_EPS) -> tuple[F64, F64]:
    """Weights (out, in, k, k) and bias (out,) of a convolution with its batch norm folded in, float64."""
    gamma, beta, mean, var = (
        np.asarray(state[f"{norm}.{part}"], np.float64)
        for part in ("weight", "bias", "running_mean", "running_var")
    )
    scale = gamma / np.sqrt(var + eps)
    weight = np.asarray(state[f"{conv}.weight"], np.float64) * scale[:, None, None, None]
    return weight, beta - mean * scale


def store_weights(graph: Graph, weight: NDArray[np.floating], dtype: np.dtype[Any]) -> Value:
    """Store weights in a graph; float16 is widened when it is loaded. Errors: ConfigError for too large ones."""
    if dtype == np.float32:
        return graph.constant(np.asarray(weight, np.float32))
    most = float(np.abs(weight).max())
    if most > float(np.finfo(np.float16).max):
        raise ConfigError(f"a weight of {most:.3g} exceeds float16; store this trunk as float32")
    return graph.op("Cast", graph.constant(np.asarray(weight, np.float16)), to=1)


class _TrunkBuilder:
    """Builds one trunk, layer after layer."""

    def __init__(self, net: Topology, state: State, weights: Literal["float32", "float16"]) -> None:
        self.graph = Graph(net.name)
        self._net, self._state, self._dtype = net, state, np.dtype(weights)

    def run(self, x: Value, wanted: set[str]) -> dict[str, tuple[Value, int]]:
        """Build until every wanted block, `relu`, `maxpool` or `avgpool` exists: its value and channels by name."""
        outputs: dict[str, tuple[Value, int]] = {}
        x = self.graph.op("Relu", self._conv(x, self._net.stem))
        outputs["relu"] = x, self._net.stem.outputs
        x = self.graph.op("MaxPool", x, kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1])
        outputs["maxpool"] = x, self._net.stem.outputs
        for block in self._net.blocks:
            if wanted <= outputs.keys():
                return outputs
            shortcut = self._conv(x, block.shortcut) if block.shortcut else x
            for conv in block.convs[:-1]:
                x = self.graph.op("Relu", self._conv(x, conv))
            x = self.graph.op("Relu", self.graph.op("Add", self._conv(x, block.convs[-1]), shortcut))
            outputs[block.name] = x, block.convs[-1].outputs
        if "avgpool" in wanted:
            outputs["avgpool"] = self.graph.op("GlobalAveragePool", x), self._net.channels(3)
        return outputs

    def _conv(self, x: Value, conv: Conv) -> Value:
        weight, bias = folded(self._state, conv.name, conv.norm)
        return self.graph.op(
            "Conv",
            x,
            store_weights(self.graph, weight, self._dtype),
            self.graph.constant(bias.astype(np.float32)),
            kernel_shape=[conv.kernel] * 2,
            strides=[conv.stride] * 2,
            pads=[conv.padding] * 4,
        )
