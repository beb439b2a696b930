"""`build_vqgan_trunk`: the encoder of a VQGAN becomes an ONNX graph from frames to feature maps."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from plugins.backbones.input_steps import InputSteps, input_planes
from plugins.backbones.topology import State
from plugins.backbones.vqgan import GROUPS, NORM_EPS, VqganLayer, vqgan_layers
from plugins.onnx_builder import Graph, Value

__all__ = ["build_vqgan_trunk"]


def build_vqgan_trunk(
    state: State,
    taps: Sequence[str],
    steps: InputSteps,
    frame: tuple[int, int],
    *,
    weights: Literal["float32", "float16"] = "float32",
    facts: Mapping[str, str] | None = None,
) -> bytes:
    """The trunk as serialised ONNX: `frames` uint8 (n, h, w, 3) to one float32 (n, c, h', w') per tap.

    frame: (h, w), fixed. steps.size: the network's input where it differs. Errors: ConfigError for taps, weights or
    sizes that do not fit.
    """
    layers = vqgan_layers(state, taps)
    size = steps.size or frame
    stride = max(layer.stride for layer in layers)
    if size[0] % stride or size[1] % stride or layers[0].inputs != 3 * steps.copies:
        raise ConfigError(
            f"the network reads {layers[0].inputs} channels in multiples of {stride} pixels; found "
            f"{3 * steps.copies} channels of {size[0]}x{size[1]} (h, w); resize with --size"
        )
    builder = _VqganBuilder(state, weights, size)
    x = input_planes(builder.graph, steps, frame)
    for layer in layers:
        x = builder.add(layer, x)
        if layer.tap in taps:
            builder.graph.output(layer.tap, x, ("n", layer.outputs, *builder.cells(layer)))
    described = {"topology": f"vqgan_{layers[0].outputs}", "preprocessing": steps.words}
    return builder.graph.serialise({**described, **(facts or {})})


class _VqganBuilder:
    """Builds one encoder, layer after layer. size: (h, w) of the network's input."""

    def __init__(self, state: State, weights: Literal["float32", "float16"], size: tuple[int, int]) -> None:
        self.graph = Graph("vqgan")
        self._state, self._dtype, self._size = state, np.dtype(weights), size

    def cells(self, layer: VqganLayer) -> tuple[int, int]:
        """Rows and columns of a layer's output."""
        return self._size[0] // layer.stride, self._size[1] // layer.stride

    def add(self, layer: VqganLayer, x: Value) -> Value:
        """The layer's output for its input."""
        match layer.kind:
            case "conv" | "latent":
                return self._conv(x, layer.name)
            case "halving":
                # One row and one column of zeros, below and to the right, and no other padding.
                return self._conv(x, layer.name, stride=2, pads=(0, 0, 1, 1))
            case "head":
                return self._conv(self._swish(self._norm(x, "encoder.norm_out", layer)), layer.name)
            case "attention":
                return self._attention(x, layer)
            case "block":
                return self._block(x, layer)

    def _block(self, x: Value, layer: VqganLayer) -> Value:
        name = layer.name
        y = self._conv(self._swish(self._norm(x, f"{name}.norm1", layer)), f"{name}.conv1")
        y = self._conv(self._swish(self._norm(y, f"{name}.norm2", layer)), f"{name}.conv2")
        shortcut = self._conv(x, f"{name}.nin_shortcut") if layer.inputs != layer.outputs else x
        return self.graph.op("Add", shortcut, y)

    def _attention(self, x: Value, layer: VqganLayer) -> Value:
        """Every cell looks at all cells: one head, of all channels."""
        g, name = self.graph, layer.name
        y = self._norm(x, f"{name}.norm", layer)
        q, k, v = (g.reshape(self._conv(y, f"{name}.{part}"), 0, layer.inputs, -1) for part in "qkv")
        scores = g.op("MatMul", g.transpose(g.op("Mul", q, g.scalar(layer.inputs**-0.5)), 0, 2, 1), k)
        mixed = g.op("MatMul", v, g.transpose(g.op("Softmax", scores, axis=-1), 0, 2, 1))
        mixed = g.reshape(mixed, 0, layer.inputs, *self.cells(layer))
        return g.op("Add", x, self._conv(mixed, f"{name}.proj_out"))

    def _norm(self, x: Value, name: str, layer: VqganLayer) -> Value:
        """A group norm: every group of channels is one channel of an instance norm."""
        g, channels = self.graph, len(self._state[f"{name}.weight"])
        ones, zeros = (g.constant(np.full(GROUPS, value, np.float32)) for value in (1, 0))
        y = g.op("InstanceNormalization", g.reshape(x, 0, GROUPS, -1), ones, zeros, epsilon=NORM_EPS)
        weight, bias = (
            g.constant(np.asarray(self._state[f"{name}.{part}"], np.float32).reshape(1, channels, 1, 1))
            for part in ("weight", "bias")
        )
        y = g.reshape(y, 0, channels, *self.cells(layer))
        return g.op("Add", g.op("Mul", y, weight), bias)

    def _swish(self, x: Value) -> Value:
        return self.graph.op("Mul", x, self.graph.op("Sigmoid", x))

    def _conv(
        self, x: Value, name: str, stride: int = 1, pads: tuple[int, int, int, int] | None = None
    ) -> Value:
        weight = np.asarray(self._state[f"{name}.weight"])
        kernel = weight.shape[2]
        return self.graph.op(
            "Conv",
            x,
            self._store(weight),
            self.graph.constant(np.asarray(self._state[f"{name}.bias"], np.float32)),
            kernel_shape=[kernel] * 2,
            strides=[stride] * 2,
            pads=list(pads or (kernel // 2,) * 4),
        )

    def _store(self, weight: NDArray[np.floating]) -> Value:
        if self._dtype == np.float32:
            return self.graph.constant(np.asarray(weight, np.float32))
        most = float(np.abs(weight).max())
        if most > float(np.finfo(np.float16).max):
            raise ConfigError(f"a weight of {most:.3g} exceeds float16; store this trunk as float32")
        return self.graph.op("Cast", self.graph.constant(np.asarray(weight, np.float16)), to=1)
