"""The same network in float64 NumPy, unfolded and slow: the reference for the ONNX trunks."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from plugins.backbones.resnet import NORM_EPS, TAPS
from plugins.backbones.topology import Conv, State, last_block, topology

__all__ = ["Norm", "batch_norm", "forward"]

Array = NDArray[np.floating]
Norm = Callable[[Conv, Array], Array]
"""The operation after a convolution: takes the convolution and its output (n, c, h, w)."""


def batch_norm(state: State) -> Norm:
    """Batch normalisation with the state's running statistics, as the framework defines it."""

    def norm(conv: Conv, x: Array) -> Array:
        gamma, beta, mean, var = (
            np.asarray(state[f"{conv.norm}.{part}"], x.dtype)[:, None, None]
            for part in ("weight", "bias", "running_mean", "running_var")
        )
        result: Array = (x - mean) / np.sqrt(var + NORM_EPS) * gamma + beta
        return result

    return norm


def forward(
    state: State, topology_name: str, planes: Array, taps: Sequence[str] = TAPS, norm: Norm | None = None
) -> dict[str, Array]:
    """Normalised planes (n, 3, h, w) to taps (n, c, h', w'), in the precision of `planes`.

    norm: the operation after each convolution; batch normalisation with the state's statistics when None.
    """
    net = topology(topology_name)
    norm = norm or batch_norm(state)
    wanted = {tap: last_block(net, tap) for tap in taps}

    def conv(x: Array, layer: Conv) -> Array:
        return norm(layer, _convolve(x, np.asarray(state[f"{layer.name}.weight"], x.dtype), layer))

    x = np.maximum(conv(planes, net.stem), 0)
    seen = {"relu": x}
    x = seen["maxpool"] = _max_pool(x)
    for block in net.blocks:
        if set(wanted.values()) <= seen.keys():
            break
        shortcut = conv(x, block.shortcut) if block.shortcut else x
        for layer in block.convs[:-1]:
            x = np.maximum(conv(x, layer), 0)
        x = seen[block.name] = np.maximum(conv(x, block.convs[-1]) + shortcut, 0)
    seen["avgpool"] = x.mean(axis=(2, 3), keepdims=True)
    return {tap: seen[block] for tap, block in wanted.items()}


def _convolve(x: Array, weight: Array, layer: Conv) -> Array:
    p, s = layer.padding, layer.stride
    padded = np.pad(x, ((0, 0), (0, 0), (p, p), (p, p)))
    windows = sliding_window_view(padded, (layer.kernel, layer.kernel), axis=(2, 3))[:, :, ::s, ::s]
    result: Array = np.tensordot(windows, weight, axes=((1, 4, 5), (1, 2, 3))).transpose(0, 3, 1, 2)
    return result


def _max_pool(x: Array) -> Array:
    """3x3, stride 2, one cell of padding with minus infinity."""
    padded = np.pad(x, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
    result: Array = sliding_window_view(padded, (3, 3), axis=(2, 3))[:, :, ::2, ::2].max(axis=(4, 5))
    return result
