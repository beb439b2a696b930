"""The same encoder in float64 NumPy, unfolded and slow: the reference for the ONNX trunks of `vqgan_trunk`."""

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from plugins.backbones.topology import State
from plugins.backbones.vqgan import GROUPS, NORM_EPS, VqganLayer, vqgan_layers

__all__ = ["vqgan_forward"]

Array = NDArray[np.float64]


def vqgan_forward(state: State, planes: Array, taps: Sequence[str]) -> dict[str, Array]:
    """Network inputs (n, 3, h, w) to taps (n, c, h', w'), in float64."""
    seen, x = {}, planes
    for layer in vqgan_layers(state, taps):
        x = _layer(state, layer, x)
        if layer.tap:
            seen[layer.tap] = x
    return {tap: seen[tap] for tap in taps}


def _layer(state: State, layer: VqganLayer, x: Array) -> Array:
    match layer.kind:
        case "conv" | "latent":
            return _convolved(state, layer.name, x)
        case "halving":
            weight = np.asarray(state[f"{layer.name}.weight"], np.float64)
            return _windows(np.pad(x, ((0, 0), (0, 0), (0, 1), (0, 1))), weight, 2) + _bias(state, layer.name)
        case "head":
            return _convolved(state, layer.name, _swish(_norm(state, "encoder.norm_out", x)))
        case "attention":
            return _attention(state, layer.name, x)
        case "block":
            return _block(state, layer.name, x)


def _block(state: State, name: str, x: Array) -> Array:
    y = _convolved(state, f"{name}.conv1", _swish(_norm(state, f"{name}.norm1", x)))
    y = _convolved(state, f"{name}.conv2", _swish(_norm(state, f"{name}.norm2", y)))
    is_wider = y.shape[1] != x.shape[1]
    return y + (_convolved(state, f"{name}.nin_shortcut", x) if is_wider else x)


def _attention(state: State, name: str, x: Array) -> Array:
    y = _norm(state, f"{name}.norm", x)
    q, k, v = (_convolved(state, f"{name}.{part}", y).reshape(*x.shape[:2], -1) for part in "qkv")
    scores = np.einsum("nci,ncj->nij", q, k) / np.sqrt(x.shape[1])
    weights = np.exp(scores - scores.max(axis=2, keepdims=True))
    mixed = np.einsum("nij,ncj->nci", weights / weights.sum(axis=2, keepdims=True), v)
    return x + _convolved(state, f"{name}.proj_out", mixed.reshape(x.shape))


def _norm(state: State, name: str, x: Array) -> Array:
    groups = x.reshape(len(x), GROUPS, -1)
    centred = groups - groups.mean(axis=2, keepdims=True)
    scaled = centred / np.sqrt((centred**2).mean(axis=2, keepdims=True) + NORM_EPS)
    weight = np.asarray(state[f"{name}.weight"], np.float64)[:, None, None]
    result: Array = scaled.reshape(x.shape) * weight + _bias(state, name)
    return result


def _swish(x: Array) -> Array:
    result: Array = x / (1 + np.exp(-x))
    return result


def _convolved(state: State, name: str, x: Array) -> Array:
    """A convolution of odd size over zeros around x."""
    weight = np.asarray(state[f"{name}.weight"], np.float64)
    p = weight.shape[2] // 2
    return _windows(np.pad(x, ((0, 0), (0, 0), (p, p), (p, p))), weight, 1) + _bias(state, name)


def _windows(x: Array, weight: Array, stride: int) -> Array:
    windows = sliding_window_view(x, weight.shape[2:], axis=(2, 3))[:, :, ::stride, ::stride]
    result: Array = np.tensordot(windows, weight, axes=((1, 4, 5), (1, 2, 3))).transpose(0, 3, 1, 2)
    return result


def _bias(state: State, name: str) -> Array:
    return np.asarray(state[f"{name}.bias"], np.float64)[:, None, None]
