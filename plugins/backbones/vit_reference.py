"""The same transformer in NumPy, slow: the reference for the ONNX trunks of `vit_trunk`."""

from collections.abc import Sequence

import numpy as np

from edge.core.arrays import F64
from plugins.backbones.topology import State
from plugins.backbones.vit import VitShape, prefix_tokens
from plugins.backbones.vit_trunk import patch_grid

__all__ = ["vit_forward"]

Array = F64

# erf by Abramowitz and Stegun 7.1.26 errs by 1.5e-7: less than float32 does.
_P, _A = 0.3275911, (0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429)


def vit_forward(state: State, shape: VitShape, planes: Array, taps: Sequence[str]) -> dict[str, Array]:
    """Network inputs (n, channels, h, w) to taps (n, d, rows, columns), in float64."""
    rows, columns = patch_grid(shape, planes.shape[2:])
    n, d, p = len(planes), shape.width, shape.patch
    cells = planes.reshape(n, shape.channels, rows, p, columns, p).transpose(0, 2, 4, 1, 3, 5)
    weight = np.asarray(state["patch_embed.proj.weight"], np.float64).reshape(d, -1)
    patches = cells.reshape(n, rows * columns, -1) @ weight.T + state.get(
        "patch_embed.proj.bias", np.zeros(d)
    )
    prefix, positions = prefix_tokens(state, shape, (rows, columns))
    x = np.concatenate([np.broadcast_to(prefix, (n, *prefix.shape)), patches + positions], axis=1)
    if "norm_pre.weight" in state:
        x = _norm(state, "norm_pre", x, shape.eps)
    seen = {}
    for number in range(shape.depth):
        x = seen[f"block{number}"] = _block(state, f"blocks.{number}", x, shape)
    if "norm" in taps:
        seen["norm"] = _norm(state, "norm", x, shape.eps)
    return {
        tap: seen[tap][:, shape.prefixes :].transpose(0, 2, 1).reshape(n, d, rows, columns) for tap in taps
    }


def _block(state: State, name: str, x: Array, shape: VitShape) -> Array:
    attended = _attention(state, name, _norm(state, f"{name}.norm1", x, shape.eps), shape)
    x = x + attended * state.get(f"{name}.ls1.gamma", 1.0)
    hidden = _linear(state, f"{name}.mlp.fc1", _norm(state, f"{name}.norm2", x, shape.eps))
    result: Array = x + _linear(state, f"{name}.mlp.fc2", _gelu(hidden)) * state.get(f"{name}.ls2.gamma", 1.0)
    return result


def _attention(state: State, name: str, x: Array, shape: VitShape) -> Array:
    n, tokens, d = x.shape
    qkv = _linear(state, f"{name}.attn.qkv", x).reshape(n, tokens, 3, shape.heads, d // shape.heads)
    q, k, v = qkv.transpose(2, 0, 3, 1, 4)
    scores = q @ k.transpose(0, 1, 3, 2) / np.sqrt(d // shape.heads)
    weights = np.exp(scores - scores.max(axis=-1, keepdims=True))
    mixed = weights / weights.sum(axis=-1, keepdims=True) @ v
    return _linear(state, f"{name}.attn.proj", mixed.transpose(0, 2, 1, 3).reshape(n, tokens, d))


def _linear(state: State, name: str, x: Array) -> Array:
    result: Array = x @ np.asarray(state[f"{name}.weight"], np.float64).T + state.get(f"{name}.bias", 0.0)
    return result


def _norm(state: State, name: str, x: Array, eps: float) -> Array:
    centred = x - x.mean(axis=-1, keepdims=True)
    scaled = centred / np.sqrt((centred**2).mean(axis=-1, keepdims=True) + eps)
    result: Array = scaled * state[f"{name}.weight"] + state[f"{name}.bias"]
    return result


def _gelu(x: Array) -> Array:
    z = np.abs(x) / np.sqrt(2)
    t = 1 / (1 + _P * z)
    series = sum(a * t ** (k + 1) for k, a in enumerate(_A))
    erf = np.sign(x) * (1 - series * np.exp(-z * z))
    result: Array = 0.5 * x * (1 + erf)
    return result
