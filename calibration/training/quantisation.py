"""The trunk as its int8 variant computes it, with gradients: quantisation-aware training.

Values are rounded where `package.quantised` puts a pair of quantise and dequantise nodes. Weights are rounded per
output channel to -127 to 127, activations per tensor to 0 to 255 over the range of the batch. Batch norms are folded in
with their present statistics. Rounding passes gradients unchanged. Ref: Jacob et al., "Quantization and Training of
Neural Networks for Efficient Integer-Arithmetic-Only Inference", CVPR 2018, section 3.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from calibration.training.network import ResidualBlock, TrunkNetwork

__all__ = ["rounded_activation", "rounded_maps", "rounded_weight"]


def rounded_maps(trunk: TrunkNetwork, frames: Tensor) -> list[Tensor]:
    """What `trunk(frames)` gives, in int8's values. The statistics of batch norms are used and not updated."""
    x = rounded_activation(trunk.normalised(frames))
    x = trunk.maxpool(rounded_activation(torch.relu(_folded(x, trunk.conv1, trunk.bn1))))
    maps = []
    for stage in trunk.stages:
        for block in getattr(trunk, stage):
            x = _block(x, block)
        maps.append(x)
    return maps


def _block(x: Tensor, block: ResidualBlock) -> Tensor:
    shortcut = x if block.downsample is None else rounded_activation(_folded(x, *block.downsample))
    x = rounded_activation(torch.relu(_folded(x, block.conv1, block.bn1)))
    x = rounded_activation(_folded(x, block.conv2, block.bn2))
    return rounded_activation(torch.relu(x + shortcut))


def _folded(x: Tensor, conv: nn.Conv2d, norm: nn.BatchNorm2d) -> Tensor:
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    weight = rounded_weight(conv.weight * scale[:, None, None, None])
    return F.conv2d(x, weight, norm.bias - norm.running_mean * scale, conv.stride, conv.padding)


def rounded_weight(weight: Tensor) -> Tensor:
    """Weights (out, in, k, k), each output channel in 127ths of its greatest."""
    step = weight.detach().abs().amax(dim=(1, 2, 3), keepdim=True).clamp(min=1e-12) / 127
    return _passing(weight, (weight.detach() / step).round() * step)


def rounded_activation(x: Tensor) -> Tensor:
    """A tensor in 255ths of its range, which holds 0 exactly."""
    fixed = x.detach()
    low, high = fixed.amin().clamp(max=0), fixed.amax().clamp(min=0)
    step = ((high - low) / 255).clamp(min=1e-12)
    zero = (low / step).round()
    return _passing(x, ((fixed / step).round() - zero).clamp(0, 255).add(zero) * step)


def _passing(x: Tensor, value: Tensor) -> Tensor:
    """`value` forward, the gradient of `x` backward."""
    return x + (value - x.detach())
