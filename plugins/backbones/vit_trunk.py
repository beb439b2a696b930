"""`build_vit_trunk`: a vision transformer's weights become an ONNX graph from frames to patch-grid feature maps.

A tap is a block's output (`block5`) or the last normalised one (`norm`): prefix tokens (class, registers, distillation)
are dropped, the sequence becomes a grid, and blocks after the last tap are not built.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from plugins.backbones.input_steps import InputSteps, input_planes
from plugins.backbones.resnet import store_weights
from plugins.backbones.topology import State
from plugins.backbones.vit import VitShape, check_vit_taps, prefix_tokens
from plugins.onnx_builder import Graph, Value

__all__ = ["build_vit_trunk", "patch_grid"]


def build_vit_trunk(
    state: State,
    shape: VitShape,
    taps: Sequence[str],
    steps: InputSteps,
    frame: tuple[int, int],
    *,
    weights: Literal["float32", "float16"] = "float32",
    facts: Mapping[str, str] | None = None,
) -> bytes:
    """The trunk as serialised ONNX: `frames` uint8 (n, h, w, 3) to one float32 (n, d, rows, columns) per tap.

    frame: (h, w), fixed, because every patch has its position. steps.size: the network's input where it differs from
    the frame. weights: how they are stored. Errors: ConfigError for taps or sizes that do not fit.
    """
    check_vit_taps(taps, shape, state)
    if shape.channels != 3 * steps.copies:
        raise ConfigError(
            f"the network reads {shape.channels} channels, the steps give {3 * steps.copies}; choose the preprocessing "
            "of this encoder"
        )
    builder = _VitBuilder(state, shape, weights, patch_grid(shape, steps.size or frame))
    outputs = builder.run(input_planes(builder.graph, steps, frame), set(taps))
    for tap in taps:
        builder.graph.output(tap, outputs[tap], ("n", shape.width, *builder.grid))
    described = {
        "topology": f"vit_{shape.width}x{shape.depth}_patch{shape.patch}",
        "preprocessing": steps.words,
    }
    return builder.graph.serialise({**described, **(facts or {})})


def patch_grid(shape: VitShape, size: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of patches in an input of (h, w). Errors: ConfigError where patches do not cover it."""
    if size[0] % shape.patch or size[1] % shape.patch:
        raise ConfigError(
            f"patches of {shape.patch} pixels do not cover an input of {size[0]}x{size[1]} (h, w); choose a multiple, "
            "or resize with --size"
        )
    return size[0] // shape.patch, size[1] // shape.patch


class _VitBuilder:
    """Builds one transformer, block after block. A sequence is (n, tokens, d)."""

    def __init__(
        self, state: State, shape: VitShape, weights: Literal["float32", "float16"], grid: tuple[int, int]
    ) -> None:
        self.graph = Graph("vit")
        self.grid = grid
        self._state, self._shape, self._dtype = state, shape, np.dtype(weights)
        self._tokens = shape.prefixes + grid[0] * grid[1]

    def run(self, planes: Value, wanted: set[str]) -> dict[str, Value]:
        """Build until every wanted tap exists."""
        outputs: dict[str, Value] = {}
        x = self._embedded(planes)
        for number in range(self._shape.depth):
            if wanted <= outputs.keys():
                return outputs
            x = self._block(x, f"blocks.{number}")
            if f"block{number}" in wanted:
                outputs[f"block{number}"] = self._as_grid(x)
        if "norm" in wanted:
            outputs["norm"] = self._as_grid(self._norm(x, "norm"))
        return outputs

    def _embedded(self, planes: Value) -> Value:
        g, shape = self.graph, self._shape
        bias = self._state.get("patch_embed.proj.bias", np.zeros(shape.width))
        patches = g.op(
            "Conv",
            planes,
            self._store(self._state["patch_embed.proj.weight"]),
            g.constant(np.asarray(bias, np.float32)),
            kernel_shape=[shape.patch] * 2,
            strides=[shape.patch] * 2,
        )
        prefix, positions = prefix_tokens(self._state, shape, self.grid)
        x = g.transpose(g.reshape(patches, 0, shape.width, self.grid[0] * self.grid[1]), 0, 2, 1)
        x = g.op("Add", x, g.constant(positions[None]))
        if shape.prefixes:
            # The tokens are the same for every frame: repeated by adding them to zeros of the batch's size.
            zeros = g.op("Mul", g.slice(x, 0, 1, 1), g.scalar(0))
            x = g.op("Concat", g.op("Add", zeros, g.constant(prefix[None])), x, axis=1)
        return self._norm(x, "norm_pre") if "norm_pre.weight" in self._state else x

    def _block(self, x: Value, name: str) -> Value:
        x = self.graph.op(
            "Add", x, self._scale(self._attention(self._norm(x, f"{name}.norm1"), name), f"{name}.ls1")
        )
        hidden = self._gelu(self._linear(self._norm(x, f"{name}.norm2"), f"{name}.mlp.fc1"))
        return self.graph.op("Add", x, self._scale(self._linear(hidden, f"{name}.mlp.fc2"), f"{name}.ls2"))

    def _attention(self, x: Value, name: str) -> Value:
        g, heads = self.graph, self._shape.heads
        each = self._shape.width // heads
        qkv = g.reshape(self._linear(x, f"{name}.attn.qkv"), 0, self._tokens, 3, heads, each)
        split = g.ops("Split", 3, g.transpose(qkv, 2, 0, 3, 1, 4), axis=0, num_outputs=3)
        q, k, v = (g.squeeze(part, 0) for part in split)
        scores = g.op("MatMul", g.op("Mul", q, g.scalar(each**-0.5)), g.transpose(k, 0, 1, 3, 2))
        mixed = g.op("MatMul", g.op("Softmax", scores, axis=-1), v)
        joined = g.reshape(g.transpose(mixed, 0, 2, 1, 3), 0, self._tokens, self._shape.width)
        return self._linear(joined, f"{name}.attn.proj")

    def _as_grid(self, x: Value) -> Value:
        """The patches' features (n, d, rows, columns), without the prefix tokens."""
        g, first = self.graph, self._shape.prefixes
        if first:
            x = g.slice(x, first, self._tokens, 1)
        return g.reshape(g.transpose(x, 0, 2, 1), 0, self._shape.width, *self.grid)

    def _linear(self, x: Value, name: str) -> Value:
        y = self.graph.op("MatMul", x, self._store(np.asarray(self._state[f"{name}.weight"]).T))
        bias = self._state.get(f"{name}.bias")
        return (
            y if bias is None else self.graph.op("Add", y, self.graph.constant(np.asarray(bias, np.float32)))
        )

    def _norm(self, x: Value, name: str) -> Value:
        weight, bias = (
            self.graph.constant(np.asarray(self._state[f"{name}.{part}"], np.float32))
            for part in ("weight", "bias")
        )
        return self.graph.op("LayerNormalization", x, weight, bias, axis=-1, epsilon=self._shape.eps)

    def _scale(self, x: Value, name: str) -> Value:
        gamma = self._state.get(f"{name}.gamma")
        return (
            x
            if gamma is None
            else self.graph.op("Mul", x, self.graph.constant(np.asarray(gamma, np.float32)))
        )

    def _gelu(self, x: Value) -> Value:
        g = self.graph
        erf = g.op("Erf", g.op("Mul", x, g.scalar(0.5**0.5)))
        return g.op("Mul", g.op("Mul", x, g.op("Add", erf, g.scalar(1))), g.scalar(0.5))

    def _store(self, weight: NDArray[np.floating]) -> Value:
        return store_weights(self.graph, weight, self._dtype)
