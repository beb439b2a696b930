"""The encoder of a VQGAN as data: its layers in order, read from the weights, in the names of taming-transformers.

    conv_in -> levels of residual blocks (some with attention), each but the last followed by a convolution of stride 2
    -> mid: block, attention, block -> norm_out, swish, conv_out -> quant_conv

Ref: Esser et al., "Taming Transformers for High-Resolution Image Synthesis", arXiv:2012.09841; CompVis
taming-transformers, taming/modules/diffusionmodules/model.py (Encoder). Names re-stated from the state dicts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edge.core.errors import ConfigError
from plugins.backbones.topology import State

__all__ = ["FIRST", "GROUPS", "NORM_EPS", "VqganLayer", "vqgan_layers"]

FIRST = "encoder.conv_in.weight"
"""The weight by which a VQGAN is recognised."""

# Of every group norm; ref: Normalize in model.py.
GROUPS = 32
NORM_EPS = 1e-6

Kind = Literal["conv", "block", "attention", "halving", "head", "latent"]


@dataclass(frozen=True)
class VqganLayer:
    """One step of the encoder. name: of its weights. tap: under which its output can be had. inputs, outputs: its
    channels. stride: between its output's pixels, in pixels of the network's input."""

    kind: Kind
    name: str
    inputs: int
    outputs: int
    stride: int
    tap: str = ""

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name to shape of every weight."""
        a, b = self.inputs, self.outputs
        match self.kind:
            case "conv" | "halving":
                return _conv(self.name, a, b, 3)
            case "latent":
                return _conv(self.name, a, b, 1)
            case "head":
                return {**_norm("encoder.norm_out", a), **_conv("encoder.conv_out", a, b, 3)}
            case "attention":
                parts = (_conv(f"{self.name}.{part}", a, a, 1) for part in ("q", "k", "v", "proj_out"))
                return {**_norm(f"{self.name}.norm", a), **{k: v for part in parts for k, v in part.items()}}
            case "block":
                shortcut = _conv(f"{self.name}.nin_shortcut", a, b, 1) if a != b else {}
                norms = {**_norm(f"{self.name}.norm1", a), **_norm(f"{self.name}.norm2", b)}
                return {
                    **norms,
                    **_conv(f"{self.name}.conv1", a, b, 3),
                    **_conv(f"{self.name}.conv2", b, b, 3),
                    **shortcut,
                }


def vqgan_layers(state: State, taps: Sequence[str] = (), name: str = "the weights") -> list[VqganLayer]:
    """The layers until the last of these taps; all when none is named.

    Taps are level0, level1, ... (before the halving), mid, and latent, what the quantiser reads. Errors: ConfigError
    for unknown or repeated taps, and for weights that are missing, wrongly shaped or not finite.
    """
    layers = list(_layers(state, name))
    known = [layer.tap for layer in layers if layer.tap]
    if len(set(taps)) != len(taps) or not set(taps) <= set(known):
        raise ConfigError(
            f"a trunk needs distinct taps of {', '.join(known)}; found {', '.join(taps) or 'none'}"
        )
    last = max((n for n, layer in enumerate(layers) if layer.tap in taps), default=len(layers) - 1)
    layers = layers[: last + 1]
    _check(state, layers, name)
    return layers


def _layers(state: State, name: str) -> Iterator[VqganLayer]:
    width, stride = _rows(state, "encoder.conv_in", name), 1
    yield VqganLayer("conv", "encoder.conv_in", _inputs(state), width, stride)
    level = 0
    while f"encoder.down.{level}.block.0.conv1.weight" in state:
        at, number = f"encoder.down.{level}", 0
        while f"{at}.block.{number}.conv1.weight" in state:
            out = _rows(state, f"{at}.block.{number}.conv1", name)
            has_attention = f"{at}.attn.{number}.q.weight" in state
            is_last = f"{at}.block.{number + 1}.conv1.weight" not in state
            tap = f"level{level}" if is_last else ""
            yield VqganLayer(
                "block", f"{at}.block.{number}", width, out, stride, "" if has_attention else tap
            )
            if has_attention:
                yield VqganLayer("attention", f"{at}.attn.{number}", out, out, stride, tap)
            width, number = out, number + 1
        level += 1
        if f"encoder.down.{level}.block.0.conv1.weight" in state:
            stride *= 2
            yield VqganLayer("halving", f"{at}.downsample.conv", width, width, stride)
    yield VqganLayer("block", "encoder.mid.block_1", width, width, stride)
    yield VqganLayer("attention", "encoder.mid.attn_1", width, width, stride)
    yield VqganLayer("block", "encoder.mid.block_2", width, width, stride, "mid")
    out = _rows(state, "encoder.conv_out", name)
    yield VqganLayer("head", "encoder.conv_out", width, out, stride)
    yield VqganLayer("latent", "quant_conv", out, _rows(state, "quant_conv", name), stride, "latent")


def _rows(state: State, conv: str, name: str) -> int:
    """Read the output channels of a convolution. Errors: ConfigError where it is missing or has another shape."""
    weight = state.get(f"{conv}.weight")
    if weight is None or weight.ndim != 4:
        problem = "missing" if weight is None else f"of shape {weight.shape}"
        raise ConfigError(
            f"{name} are not a VQGAN in taming-transformers' naming: '{conv}.weight' is {problem}, four axes are "
            "expected; give the checkpoint of the complete VQModel"
        )
    return int(weight.shape[0])


def _inputs(state: State) -> int:
    return int(state[FIRST].shape[1])


def _conv(name: str, inputs: int, outputs: int, kernel: int) -> dict[str, tuple[int, ...]]:
    return {f"{name}.weight": (outputs, inputs, kernel, kernel), f"{name}.bias": (outputs,)}


def _norm(name: str, channels: int) -> dict[str, tuple[int, ...]]:
    return {f"{name}.weight": (channels,), f"{name}.bias": (channels,)}


def _check(state: State, layers: Sequence[VqganLayer], name: str) -> None:
    """Refuse missing, wrongly shaped and non-finite weights. Errors: ConfigError with a few of their names."""
    known = {key: shape for layer in layers for key, shape in layer.shapes.items()}
    thin = [layer.name for layer in layers if layer.kind in ("block", "attention") and layer.inputs % GROUPS]
    missing = [key for key in known if key not in state]
    wrong = [
        f"{key} {tuple(state[key].shape)} instead of {shape}"
        for key, shape in known.items()
        if key in state and tuple(state[key].shape) != shape
    ]
    bad = [key for key in known if key in state and not np.isfinite(state[key]).all()]
    kinds = (
        ("missing", missing),
        ("wrongly shaped", wrong),
        ("not finite", bad),
        (f"with channels that {GROUPS} groups do not divide", thin),
    )
    faults = [
        f"{len(names)} {what} ({', '.join(names[:4])}{', ...' if len(names) > 4 else ''})"
        for what, names in kinds
        if names
    ]
    if faults:
        raise ConfigError(f"{name} are not a VQGAN in taming-transformers' naming: {'; '.join(faults)}")
