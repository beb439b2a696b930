"""The network in plain torch: ResNet-18 up to layer3 under torchvision's names, and the heads that only training uses.

Ref: He et al., "Deep Residual Learning for Image Recognition", CVPR 2016, table 1, 18 layers.
"""

import torch
from torch import Tensor, nn

from calibration.training.train_config import STAGES

__all__ = ["TrunkNetwork", "heads"]

# As the ONNX trunk normalises, so the same graph works with ImageNet weights.
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)

_CHANNELS = (64, 128, 256)
# Slopes along x and y, depth, and gradient energy.
GEOMETRY_CHANNELS = 4


class ResidualBlock(nn.Module):  # type: ignore[misc]
    """Two 3x3 convolutions and a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        shortcut = x if self.downsample is None else self.downsample(x)
        x = torch.relu(self.bn1(self.conv1(x)))
        return torch.relu(self.bn2(self.conv2(x)) + shortcut)


class TrunkNetwork(nn.Module):  # type: ignore[misc]
    """Frames (n, 3, h, w), grey levels 0 to 255 RGB, to the maps of layer1, layer2 and layer3 (strides 4, 8, 16)."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        inputs = 64
        for stage, outputs in zip(STAGES, _CHANNELS, strict=True):
            stride = 1 if stage == "layer1" else 2
            setattr(
                self,
                stage,
                nn.Sequential(ResidualBlock(inputs, outputs, stride), ResidualBlock(outputs, outputs, 1)),
            )
            inputs = outputs
        self.register_buffer("_scale", 1 / (255 * torch.tensor(STD).view(1, 3, 1, 1)), persistent=False)
        self.register_buffer(
            "_shift", -(torch.tensor(MEAN) / torch.tensor(STD)).view(1, 3, 1, 1), persistent=False
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, frames: Tensor) -> list[Tensor]:
        x = self.maxpool(torch.relu(self.bn1(self.conv1(frames * self._scale + self._shift))))
        maps = []
        for stage in STAGES:
            x = getattr(self, stage)(x)
            maps.append(x)
        return maps


def heads() -> nn.ModuleDict:
    """Make one 1x1 convolution per stage, from features to the geometry under each cell."""
    return nn.ModuleDict(
        {s: nn.Conv2d(c, GEOMETRY_CHANNELS, 1) for s, c in zip(STAGES, _CHANNELS, strict=True)}
    )
